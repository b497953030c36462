"use strict";
// The scene in space, drawn on a canvas: camera, arm's base, shafts and tips. Drag or arrow keys turn it, with Shift they move it.
(() => {
  const canvas = document.getElementById("scene");
  if (!canvas) return;
  const scene = JSON.parse(canvas.dataset.scene);
  const figure = canvas.closest("figure");
  const points = scene.frames.flatMap((frame) => frame.slice(2)).concat([[0, 0, 0]], scene.base || []);
  const middle = [0, 1, 2].map((k) => (Math.min(...points.map((p) => p[k])) + Math.max(...points.map((p) => p[k]))) / 2);
  const reach = Math.max(1, ...points.map((p) => Math.hypot(...p.map((value, k) => value - middle[k]))));
  const START = { turn: -0.6, tilt: 0.35, zoom: 1, right: 0, down: 0 };
  let { turn, tilt, zoom, right, down } = START;
  let selected = null;
  figure.hidden = false;

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const AXES = [["x", "--s1"], ["y", "--s2"], ["z", "--s0"]]; // colours as in the overlays
  const statuses = { ok: "--s0", doubtful: "--doubtful", failed: "--failed" };

  function project(point) {
    const [x, y, z] = point.map((value, k) => value - middle[k]);
    const across = Math.cos(turn) * x + Math.sin(turn) * z;
    const deep = -Math.sin(turn) * x + Math.cos(turn) * z;
    const below = Math.cos(tilt) * y + Math.sin(tilt) * deep;
    const scale = (0.46 * zoom * Math.min(canvas.clientWidth, canvas.clientHeight)) / reach;
    return [canvas.clientWidth / 2 + right + scale * across, canvas.clientHeight / 2 + down + scale * below];
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.lineCap = "round";
    pen.font = "13px system-ui, sans-serif";
    const line = (from, to, stroke, width) => {
      pen.strokeStyle = stroke;
      pen.lineWidth = width;
      pen.beginPath();
      pen.moveTo(...project(from));
      pen.lineTo(...project(to));
      pen.stroke();
    };
    const text = (words, at, ink) => {
      const [u, v] = project(at);
      pen.fillStyle = ink;
      pen.fillText(words, u + 5, v - 4);
    };
    const ink = colour("--ink");
    const size = 0.12 * reach;
    const corners = [[-1, -0.75], [1, -0.75], [1, 0.75], [-1, 0.75]].map(([x, y]) => [x * size * 0.5, y * size * 0.5, size]);
    corners.forEach((corner, k) => {
      line([0, 0, 0], corner, ink, 1);
      line(corner, corners[(k + 1) % 4], ink, 1);
    });
    text("camera", [0, 0, 0], ink);
    AXES.forEach(([name, own], k) => {
      const end = [0, 1, 2].map((axis) => (axis === k ? 2 * size : 0));
      line([0, 0, 0], end, colour(own), 1.5);
      text(name, end, colour(own));
    });
    if (scene.base) {
      const [x, y, z, origin] = scene.base;
      [x, y, z].forEach((end, k) => line(origin, end, colour(AXES[k][1]), 3));
      text("base (RCM)", origin, ink);
    }
    pen.globalAlpha = scene.frames.length > 60 ? 0.45 : 1;
    for (const [place, status, start, root, ...tips] of scene.frames) {
      const stroke = colour(statuses[status]);
      const width = place === selected ? 4 : 1.5;
      line(start, root, stroke, width);
      for (const tip of tips) {
        line(root, tip, stroke, width);
        const [u, v] = project(tip);
        pen.fillStyle = stroke;
        pen.beginPath();
        pen.arc(u, v, place === selected ? 4 : 2.5, 0, 2 * Math.PI);
        pen.fill();
      }
    }
    pen.globalAlpha = 1;
  }

  let from = null;
  canvas.addEventListener("pointerdown", (event) => {
    from = { x: event.clientX, y: event.clientY, turn, tilt, right, down, moves: event.shiftKey || event.button !== 0 };
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointermove", (event) => {
    if (!from) return;
    const [x, y] = [event.clientX - from.x, event.clientY - from.y];
    if (from.moves) [right, down] = [from.right + x, from.down + y];
    else [turn, tilt] = [from.turn - 0.01 * x, Math.max(-1.57, Math.min(1.57, from.tilt + 0.01 * y))];
    draw();
  });
  canvas.addEventListener("pointerup", () => (from = null));
  canvas.addEventListener("dblclick", () => {
    ({ turn, tilt, zoom, right, down } = START);
    draw();
  });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    const factor = { "+": 1.25, "-": 0.8 }[event.key];
    if (!step && !factor) return;
    event.preventDefault();
    event.stopPropagation();
    if (step && event.shiftKey) [right, down] = [right - 200 * step[0], down + 200 * step[1]];
    else if (step) [turn, tilt] = [turn + step[0], Math.max(-1.57, Math.min(1.57, tilt + step[1]))];
    if (factor) zoom = Math.max(0.5, Math.min(20, zoom * factor));
    draw();
  });
  document.addEventListener(
    "toggle",
    (event) => {
      const card = event.target instanceof Element && event.target.closest("article");
      if (!card || !event.target.open) return;
      selected = Number(card.dataset.place);
      draw();
    },
    true,
  );
  addEventListener("resize", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
})();
