"use strict";
// Sorting, filtering and keyboard navigation of the frames; tooltips of plots. The page can be read without scripts.
(() => {
  const grid = document.getElementById("grid");
  const cards = [...grid.children];
  const byDoubt = new Map(cards.map((card, index) => [card, index]));
  const byPlace = [];
  for (const card of cards) byPlace[Number(card.dataset.place)] = card;
  const order = document.getElementById("order");
  const find = document.getElementById("find");
  const chips = [...document.querySelectorAll("[name=status]")];
  const words = new Map();
  document.documentElement.classList.add("js");
  document.getElementById("tools").hidden = false;

  const summary = (card) => card.querySelector("summary");
  const details = (card) => card.querySelector("details");
  const title = (card) => card.querySelector("h3").textContent;
  const visible = () => [...grid.children].filter((card) => !card.hidden);

  function wordsOf(card) {
    if (!words.has(card)) {
      const lines = [...card.querySelectorAll(".words li")].map((line) => line.textContent);
      words.set(card, [title(card), ...lines].join("\n").toLowerCase());
    }
    return words.get(card);
  }

  function sift() {
    const wanted = find.value.trim().toLowerCase();
    const statuses = new Set(chips.filter((chip) => chip.checked).map((chip) => chip.value));
    let number = 0;
    for (const card of cards) {
      card.hidden = !statuses.has(card.dataset.status) || (wanted !== "" && !wordsOf(card).includes(wanted));
      if (!card.hidden) number += 1;
    }
    document.getElementById("shown").textContent = `${number} of ${cards.length}`;
    document.getElementById("none").hidden = number > 0;
    layTiles(grid, Infinity);
  }

  function sort() {
    const [, minus, key] = /^(-?)(.*)$/.exec(order.value);
    const sign = minus ? -1 : 1;
    const value = (card) => {
      if (key === "doubt") return byDoubt.get(card);
      return key in card.dataset ? sign * Number(card.dataset[key]) : Infinity;
    };
    const sorted = cards.map((card) => [value(card), byDoubt.get(card), card]);
    sorted.sort((a, b) => (a[0] === b[0] ? a[1] - b[1] : a[0] - b[0]));
    grid.append(...sorted.map((entry) => entry[2]));
  }

  // If the details of the last frame are open, they are closed and those of the next frame opened.
  function go(card, from) {
    if (!card) return;
    const opened = from && from !== card && details(from).open;
    if (opened) {
      details(from).open = false;
      details(card).open = true;
    }
    summary(card).focus({ preventScroll: true });
    card.scrollIntoView({ block: details(card).open ? "start" : "nearest" });
  }

  function show(card) {
    if (card.hidden) {
      find.value = "";
      for (const chip of chips) chip.checked = true;
      sift();
    }
    details(card).open = true;
    go(card, null);
  }

  function columns(shown) {
    const top = shown[0].offsetTop;
    const next = shown.findIndex((card) => card.offsetTop !== top);
    return next < 0 ? shown.length : next;
  }

  function step(key, from) {
    const shown = visible();
    const at = shown.indexOf(from);
    if (!shown.length) return null;
    if (at < 0) return shown[0];
    const row = details(from).open ? 1 : columns(shown);
    const by = { j: 1, ArrowRight: 1, k: -1, ArrowLeft: -1, ArrowDown: row, ArrowUp: -row }[key];
    return shown[Math.min(Math.max(at + by, 0), shown.length - 1)];
  }

  document.addEventListener("keydown", (event) => {
    const target = event.target instanceof Element ? event.target : document.body;
    if (event.altKey || event.ctrlKey || event.metaKey || event.isComposing) return;
    if (target.matches("input, select, textarea")) {
      if (event.key === "Escape" && target === find) {
        find.value = "";
        sift();
      }
      return;
    }
    const card = target.closest("article");
    const onFrame = card !== null && target.matches("summary");
    const arrow = event.key.startsWith("Arrow");
    if (event.key === "j" || event.key === "k" || (arrow && onFrame)) {
      event.preventDefault();
      go(step(event.key, card), card);
    } else if (event.key === "Escape" && card) {
      details(card).open = false;
      go(card, null);
    } else if (event.key === "/") {
      event.preventDefault();
      find.focus();
    }
  });

  // A frame with open details moves to a row of its own, which may be outside the visible part of the page.
  grid.addEventListener(
    "toggle",
    (event) => {
      grid.classList.toggle("opened", grid.querySelector("details[open]") !== null);
      const box = event.target.getBoundingClientRect();
      if (event.target.open && (box.top < 0 || box.top > 0.6 * innerHeight)) event.target.scrollIntoView();
    },
    true,
  );

  const layAll = () => {
    for (const tiles of document.querySelectorAll(".figures, .pictures")) layTiles(tiles, 2);
    layTiles(grid, Infinity);
  };
  addEventListener("resize", layAll);

  // A click enlarges a picture to the width of its card, or reduces it again; with a modifier key it follows the link.
  document.addEventListener("click", (event) => {
    const link = event.target instanceof Element && event.target.closest(".picture .crop");
    if (!link || event.ctrlKey || event.metaKey || event.shiftKey || event.altKey) return;
    event.preventDefault();
    if (Number(link.parentElement.dataset.zoom || 1) === 1) link.closest(".body").classList.toggle("large");
  });

  // A page that was moved without its folder has only the small pictures.
  document.addEventListener(
    "error",
    (event) => {
      const image = event.target;
      if (!(image instanceof HTMLImageElement)) return;
      if (image.dataset.instead) {
        const small = document.getElementById(image.dataset.instead).querySelector("summary img");
        const line = image.closest(".picture").querySelector(".missing");
        if (!line.hidden) return;
        line.hidden = false;
        image.closest(".crop").className = "crop";
        if (small) image.src = small.src;
      } else if (image.closest(".pictures li, .predicted")) {
        image.closest(".pictures li, .predicted").hidden = true;
        layAll();
      }
    },
    true,
  );

  order.addEventListener("change", sort);
  find.addEventListener("input", sift);
  for (const chip of chips) chip.addEventListener("change", sift);
  document.getElementById("tools").addEventListener("submit", (event) => event.preventDefault());
  for (const link of document.querySelectorAll("[data-find]")) {
    link.addEventListener("click", () => {
      find.value = link.dataset.find;
      sift();
    });
  }

  const fromAddress = () => {
    const card = location.hash.startsWith("#frame-") && document.getElementById(location.hash.slice(1));
    if (card) show(card);
  };
  addEventListener("hashchange", fromAddress);

  const tip = document.getElementById("tip");
  const light = (place) => {
    for (const mark of document.querySelectorAll(".plot .lit")) mark.classList.remove("lit");
    if (place !== null) for (const mark of document.querySelectorAll(`.plot [data-f="${place}"]`)) mark.classList.add("lit");
  };
  for (const plot of document.querySelectorAll(".plot")) {
    plot.addEventListener("pointerover", (event) => {
      const place = event.target.dataset.f;
      tip.hidden = place === undefined;
      light(place === undefined ? null : place);
      if (place === undefined) return;
      tip.textContent = `${title(byPlace[place])}, ${byPlace[place].dataset.status}`;
      const width = document.documentElement.clientWidth;
      tip.style.left = `${Math.max(4, Math.min(event.pageX + 12, width - tip.offsetWidth - 8))}px`;
      tip.style.top = `${event.pageY - 32}px`;
    });
    plot.addEventListener("pointerleave", () => {
      tip.hidden = true;
      light(null);
    });
    plot.addEventListener("click", (event) => {
      const place = event.target.dataset.f;
      if (place !== undefined) show(byPlace[place]);
    });
  }

  // Browsers keep the state of form elements when a page is reloaded.
  if (order.value !== "doubt") sort();
  sift();
  layAll();
  fromAddress();
})();
