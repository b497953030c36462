"use strict";
// Curves on a canvas. Where there are more values than pixels, each pixel column shows its least and largest value.
const LEFT = 52;
const RIGHT = 8;
const TOP = 6;
const BOTTOM = 20;

const cssColour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// Fit a canvas to its place on the screen; returns its pen, in CSS pixels.
function clearedPen(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * ratio);
  const height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width) canvas.width = width;
  if (canvas.height !== height) canvas.height = height;
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
  return pen;
}

// The smallest of 1, 2, 5 times a power of ten that divides a span into at most so many parts.
function roundStep(span, most) {
  const power = 10 ** Math.floor(Math.log10(span / most));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step * most >= span * (1 - 1e-9));
}

function ticks(low, high, most) {
  const step = roundStep(high - low, most);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1)
    found.push([k * step, (k * step + 0).toFixed(digits).replace(/^-(0\.?0*)$/, "$1")]);
  return found;
}

// Range of the values from frame `first` to `last` of some curves, without the half per cent beyond it at each end.
function valueRange(curves, first, last) {
  const every = Math.max(1, Math.floor(((last - first + 1) * curves.length) / 6000));
  const seen = [];
  for (const curve of curves)
    for (let k = first; k <= last; k += every) if (Number.isFinite(curve.values[k])) seen.push(curve.values[k]);
  if (!seen.length) return [0, 1];
  seen.sort((a, b) => a - b);
  const low = seen[Math.floor(0.005 * (seen.length - 1))];
  const high = seen[Math.ceil(0.995 * (seen.length - 1))];
  const margin = Math.max(0.08 * (high - low), 1e-3, 1e-3 * Math.abs(high));
  return [low >= 0 && low < margin ? 0 : low - margin, high + margin];
}

// Trace one curve; `across` maps frames to pixels and `up` values to pixels.
function traceCurve(pen, values, first, last, across, up) {
  pen.beginPath();
  let open = false;
  let column = NaN;
  let least = 0;
  let most = 0;
  let end = 0;
  const flush = () => {
    if (Number.isNaN(column)) return;
    if (most - least > 0.5) {
      pen.lineTo(column, least);
      pen.lineTo(column, most);
      pen.lineTo(column, end);
    }
  };
  for (let k = first; k <= last; k += 1) {
    const value = values[k];
    if (!Number.isFinite(value)) {
      flush();
      column = NaN;
      open = false;
      continue;
    }
    const x = Math.round(2 * across(k)) / 2;
    const y = up(value);
    if (open && x === column) {
      least = Math.min(least, y);
      most = Math.max(most, y);
      end = y;
      continue;
    }
    flush();
    if (open) pen.lineTo(x, y);
    else {
      pen.moveTo(x, y);
      pen.lineTo(x + 0.5, y); // a value between gaps is a dot
    }
    open = true;
    [column, least, most, end] = [x, y, y, y];
  }
  flush();
  pen.stroke();
}

// Draw a chart: `shaded` are [from, to] pixels of the stretches without a pose, `marks` the ticks below.
function drawChart(canvas, chart, first, last, across, shaded, marks) {
  const pen = clearedPen(canvas);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const [low, high] = valueRange(chart.curves, first, last);
  const up = (value) => {
    const inside = Math.min(Math.max(value, low), high);
    return height - BOTTOM - ((inside - low) / (high - low)) * (height - BOTTOM - TOP);
  };
  pen.fillStyle = cssColour("--lost-soft") || cssColour("--failed-soft");
  for (const [from, to] of shaded) pen.fillRect(from, TOP, Math.max(to - from, 1), height - TOP - BOTTOM);
  pen.font = "12px system-ui, sans-serif";
  pen.fillStyle = cssColour("--quiet");
  pen.strokeStyle = cssColour("--line");
  pen.lineWidth = 1;
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (const [value, text] of ticks(low, high, Math.max(2, Math.floor(height / 36)))) {
    const y = Math.round(up(value)) + 0.5;
    pen.beginPath();
    pen.moveTo(LEFT, y);
    pen.lineTo(width - RIGHT, y);
    pen.stroke();
    pen.fillText(text, LEFT - 6, y);
  }
  pen.textBaseline = "alphabetic";
  pen.textAlign = "center";
  for (const [x, text] of marks) pen.fillText(text, x, height - 5);
  pen.save();
  pen.beginPath();
  pen.rect(LEFT, 0, width - LEFT - RIGHT, height - BOTTOM + 1);
  pen.clip();
  pen.lineJoin = "round";
  for (const curve of [...chart.curves].sort((a, b) => Number(b.faint) - Number(a.faint))) {
    pen.strokeStyle = cssColour(`--s${curve.colour % 5}`);
    pen.lineWidth = curve.faint ? 1 : 1.5;
    pen.globalAlpha = curve.faint ? 0.5 : 1;
    traceCurve(pen, curve.values, first, last, across, up);
  }
  pen.restore();
}
