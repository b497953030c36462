"use strict";
// The cursor of a followed recording, which links curves, pictures and the places to look at; zoom; keys.
(() => {
  const data = JSON.parse(document.getElementById("recording").textContent);
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const floats = (text) => new Float32Array(bytes(text).buffer);
  const count = data.frames.length;
  const status = bytes(data.status);
  const times = data.times === null ? null : floats(data.times);
  const unit = times !== null && times[count - 1] > times[0] ? "s" : "frame";
  const at = unit === "s" ? times : Float32Array.from(data.frames, (_, k) => k);
  const byName = new Map(data.frames.map((name, k) => [name, k]));
  const stops = [...new Set(data.events.flatMap(([, first, back]) => (back === null ? [first] : [first, back])))].sort((a, b) => a - b);
  const charts = [...document.querySelectorAll("#charts figure")].map((figure) => {
    const { digits, curves } = data.charts[figure.id.slice("chart-".length)];
    for (const curve of curves) curve.values = floats(curve.values);
    return { figure, digits, curves, canvas: figure.querySelector("canvas"), outputs: [...figure.querySelectorAll("output")] };
  });
  const element = (id) => document.getElementById(id);
  const [player, band, strip] = ["player", "band", "strip"].map(element);
  const tiles = strip ? [...strip.children] : [];
  const tileFrames = tiles.map((tile) => Number(tile.dataset.f));
  const lost = (k) => data.statuses[status[k]] === "lost" || data.statuses[status[k]] === "gone";
  const boxes = [band, ...charts.map((chart) => chart.canvas)].map((canvas) => canvas.parentElement);
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  let cursor = 0;
  let first = 0;
  let last = count - 1;
  let waiting = false;
  let here = null;

  document.documentElement.classList.add("js");
  player.hidden = element("charts").hidden = false;
  if (element("keys")) element("keys").hidden = false;

  // Pixels of frames in a canvas, and the frame nearest to a pixel.
  const scale = (canvas) => (canvas.clientWidth - LEFT - RIGHT) / Math.max(at[last] - at[first], 1e-9);
  const across = (canvas) => {
    const [by, from] = [scale(canvas), at[first]];
    return (k) => LEFT + (at[k] - from) * by;
  };
  function nearest(list, value) {
    let [low, high] = [0, list.length - 1];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (list[middle] <= value) low = middle;
      else high = middle;
    }
    return value - list[low] <= list[high] - value ? low : high;
  }
  const frameAt = (canvas, x) => Math.min(Math.max(nearest(at, at[first] + (x - LEFT) / scale(canvas)), first), last);

  function stretches(canvas) {
    const place = across(canvas);
    const found = [];
    for (const [kind, from, back] of data.events) {
      const to = back === null ? count - 1 : back;
      if (kind !== "switched" && to >= first && from <= last) found.push([place(Math.max(from, first)), place(Math.min(to, last))]);
    }
    return found;
  }

  function marks(canvas) {
    const most = Math.max(2, Math.floor(canvas.clientWidth / 90));
    if (first === last) return [[LEFT, data.frames[first]]];
    const by = scale(canvas);
    if (unit === "s") return ticks(at[first], at[last], most).map(([value, text]) => [LEFT + (value - at[first]) * by, `${text} s`]);
    const shorter = (name) => (name.length > 9 ? `${name.slice(0, 8)}…` : name);
    return ticks(first, last, most).filter(([k]) => Number.isInteger(k)).map(([k]) => [LEFT + (k - first) * by, shorter(data.frames[k])]);
  }

  function drawBand() {
    const pen = clearedPen(band);
    const place = across(band);
    const [right, height] = [band.clientWidth - RIGHT, band.clientHeight];
    const colours = data.statuses.map((name) => cssColour(`--${name === "lost" ? "failed" : name === "gone" ? "quiet" : name}`));
    const kinds = data.statuses.length;
    const numbers = new Uint32Array((Math.ceil(right) + 2) * kinds); // frames of each status in each column
    for (let k = first; k <= last; k += 1) {
      const end = Math.min(k < last ? Math.max(place(k + 1), place(k) + 1) : right, right);
      for (let x = Math.floor(place(k)); x < end; x += 1) numbers[x * kinds + status[k]] += 1;
    }
    const high = height - 8;
    for (let x = LEFT; x < right; x += 1) {
      const column = numbers.subarray(x * kinds, (x + 1) * kinds);
      const all = column.reduce((sum, number) => sum + number, 0);
      let top = 2 + high;
      for (let kind = kinds - 1; kind >= 0 && all; kind -= 1) {
        if (!column[kind]) continue;
        const share = kind ? Math.max(column[kind] / all, kind > 1 ? 0.4 : 0) : 1; // a loss of one frame can be seen
        const bottom = top;
        top = Math.max(2, top - share * high);
        pen.fillStyle = colours[kind];
        pen.fillRect(x, top, 1, bottom - top);
      }
    }
    pen.fillStyle = cssColour("--accent");
    for (const [kind, k] of data.events) if (kind === "switched" && k >= first && k <= last) pen.fillRect(place(k) - 1, height - 5, 2, 5);
  }

  function draw() {
    waiting = false;
    drawBand();
    for (const chart of charts) drawChart(chart.canvas, chart, first, last, across(chart.canvas), stretches(chart.canvas), marks(chart.canvas));
    move();
  }
  const redraw = () => {
    if (!waiting) requestAnimationFrame(draw);
    waiting = true;
  };

  // Show the frame at the cursor everywhere, without drawing the curves again.
  function move() {
    for (const box of boxes) {
      const canvas = box.firstElementChild;
      box.querySelector(".cursor").style.transform = `translateX(${across(canvas)(cursor)}px)`;
    }
    for (const chart of charts)
      chart.curves.forEach((curve, k) => {
        const value = curve.values[cursor];
        chart.outputs[k].textContent = Number.isFinite(value) ? value.toFixed(chart.digits).replace(/^-(0\.?0*)$/, "$1") : "-";
      });
    const name = data.statuses[status[cursor]];
    element("at-frame").textContent = data.frames[cursor];
    element("at-time").textContent = times === null ? `${cursor + 1} of ${count}` : `${times[cursor].toFixed(2)} s`;
    element("at-status").textContent = name;
    element("at-status").className = `badge ${name}`;
    const words = (data.reasons[cursor] || []).map((k) => data.texts[k]).join("; ");
    element("at-reasons").textContent = words || "\u00a0";
    if (!tiles.length) return;
    const tile = tiles[nearest(tileFrames, cursor)];
    if (tile === here) return;
    if (here) here.classList.remove("here");
    here = tile;
    here.classList.add("here");
    strip.scrollTo({ left: tile.offsetLeft - strip.offsetLeft - (strip.clientWidth - tile.clientWidth) / 2, behavior: still ? "auto" : "instant" });
  }

  function go(frame) {
    cursor = Math.min(Math.max(frame, 0), count - 1);
    if (cursor < first || cursor > last) {
      const half = Math.floor((last - first) / 2);
      show(cursor - half, cursor - half + (last - first));
    } else move();
  }

  function show(from, to) {
    const span = Math.min(Math.max(to - from, Math.min(10, count - 1)), count - 1);
    first = Math.min(Math.max(from, 0), count - 1 - span);
    last = first + span;
    redraw();
  }

  function zoom(factor) {
    const span = Math.round((last - first) * factor);
    const share = (cursor - first) / Math.max(last - first, 1);
    const from = Math.round(cursor - share * span);
    show(from, from + span);
  }

  function stop(forwards) {
    const found = forwards ? stops.find((k) => k > cursor) : stops.findLast((k) => k < cursor);
    if (found !== undefined) go(found);
  }

  const actions = { previous: () => stop(false), next: () => stop(true), wider: () => zoom(2), closer: () => zoom(0.5), all: () => show(0, count - 1) };
  for (const [id, act] of Object.entries(actions)) element(id).addEventListener("click", act);
  for (const id of ["previous", "next"]) element(id).disabled = !stops.length;

  document.addEventListener("keydown", (event) => {
    const target = event.target instanceof Element ? event.target : document.body;
    if (event.altKey || event.ctrlKey || event.metaKey || target.matches("input, select, textarea")) return;
    const by = event.shiftKey ? 10 : 1;
    const keys = {
      ArrowLeft: () => go(cursor - by), ArrowRight: () => go(cursor + by), n: actions.next, p: actions.previous,
      "+": actions.closer, "-": actions.wider, 0: actions.all,
    };
    if (!(event.key in keys)) return;
    event.preventDefault();
    keys[event.key]();
  });

  // A mouse moves the cursor and, while its button is down, selects a part to enlarge; a finger moves the cursor.
  for (const box of boxes) {
    const canvas = box.firstElementChild;
    const selected = document.createElement("i");
    let from = null;
    selected.className = "selected";
    const x = (event) => event.clientX - canvas.getBoundingClientRect().left;
    const end = () => {
      selected.remove();
      from = null;
    };
    box.addEventListener("pointermove", (event) => {
      if (event.pointerType !== "mouse" && from === null) return;
      go(frameAt(canvas, x(event)));
      if (from === null || event.pointerType !== "mouse") return;
      selected.style.left = `${Math.min(from, x(event))}px`;
      selected.style.width = `${Math.abs(x(event) - from)}px`;
    });
    box.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      from = x(event);
      box.setPointerCapture(event.pointerId);
      selected.style.width = "0";
      box.append(selected);
      go(frameAt(canvas, from));
    });
    box.addEventListener("pointerup", (event) => {
      const wide = from !== null && event.pointerType === "mouse" && Math.abs(x(event) - from) > 6;
      const ends = wide ? [from, x(event)].map((place) => frameAt(canvas, place)).sort((a, b) => a - b) : null;
      end();
      if (ends) show(...ends);
    });
    box.addEventListener("pointercancel", end);
    box.addEventListener("dblclick", actions.all);
  }

  const fromAddress = () => {
    if (!location.hash.startsWith("#frame-")) return;
    const frame = byName.get(decodeURIComponent(location.hash.slice("#frame-".length)));
    if (frame === undefined) return;
    go(frame);
    if (!element("curves").contains(document.activeElement)) element("curves").scrollIntoView();
  };
  addEventListener("hashchange", fromAddress);
  document.addEventListener("click", (event) => {
    const link = event.target instanceof Element && event.target.closest("a[href^='#frame-']");
    if (link && link.hash === location.hash) fromAddress(); // the address stays the same: no event tells of it
  });
  addEventListener("resize", () => {
    for (const container of document.querySelectorAll(".figures")) layTiles(container, 2);
    redraw();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  for (const container of document.querySelectorAll(".figures")) layTiles(container, 2);
  draw();
  fromAddress();
  document.documentElement.dataset.drawn = "true";
})();
