"use strict";
// Layers of a frame's drawing: the overlay as it was drawn, or the chosen layers of it; zoom.
(() => {
  const ZOOMS = [1, 1.5, 2, 3, 4, 6, 8];

  function choose(picture) {
    const overlay = picture.querySelector("[data-view=overlay]").checked;
    picture.classList.toggle("layered", !overlay);
    for (const box of picture.querySelectorAll("[data-layer]")) {
      picture.querySelector(`[data-part="${box.dataset.layer}"]`).classList.toggle("off", !box.checked);
    }
  }

  function zoom(picture, by) {
    const stage = picture.querySelector(".stage");
    const before = Number(stage.dataset.zoom || 1);
    const at = Math.min(Math.max(ZOOMS.indexOf(before) + by, 0), ZOOMS.length - 1);
    const middle = [stage.scrollLeft + stage.clientWidth / 2, stage.scrollTop + stage.clientHeight / 2];
    if (at > 0 && before === 1) stage.style.height = `${stage.clientHeight}px`;
    if (at === 0) stage.style.height = "";
    stage.dataset.zoom = ZOOMS[at];
    stage.style.setProperty("--zoom", ZOOMS[at]);
    stage.scrollLeft = (middle[0] * ZOOMS[at]) / before - stage.clientWidth / 2;
    stage.scrollTop = (middle[1] * ZOOMS[at]) / before - stage.clientHeight / 2;
    picture.querySelector(".zoom output").textContent = `${Math.round(100 * ZOOMS[at])} %`;
  }

  // What is the same for all frames is in the page once.
  function copyOf(id) {
    return document.getElementById(id).content.firstElementChild.cloneNode(true);
  }

  for (const picture of document.querySelectorAll(".picture")) {
    if (!picture.querySelector(".views")) picture.prepend(copyOf("views"));
    if ("legend" in picture.dataset) picture.append(copyOf("overlay-legend"));
    const tools = picture.querySelector(".views");
    tools.setAttribute("aria-label", `View of frame ${picture.closest("article").querySelector("bdi").textContent}`);
    tools.hidden = false;
    tools.addEventListener("submit", (event) => event.preventDefault());
    tools.addEventListener("change", (event) => {
      if (event.target.dataset.layer) picture.querySelector("[data-view=layers]").checked = true;
      choose(picture);
    });
    for (const button of tools.querySelectorAll("[data-zoom]")) {
      button.addEventListener("click", () => zoom(picture, Number(button.dataset.zoom)));
    }
    // An enlarged picture is moved by dragging, as with the scroll bars; the click that ends a drag does nothing.
    const stage = picture.querySelector(".stage");
    let from = null;
    stage.addEventListener("pointerdown", (event) => {
      if (event.button === 0 && Number(stage.dataset.zoom || 1) > 1 && event.pointerType === "mouse") {
        from = [event.clientX + stage.scrollLeft, event.clientY + stage.scrollTop];
      }
    });
    addEventListener("pointermove", (event) => {
      if (from) stage.scrollTo(from[0] - event.clientX, from[1] - event.clientY);
    });
    addEventListener("pointerup", () => {
      from = null;
    });
    if (picture.querySelector("[data-view=overlay]")) choose(picture); // browsers keep what was chosen before a reload
  }
})();
