"use strict";
const find = document.getElementById("find");
const select = () => {
  const words = find.value.toLowerCase();
  const all = [...document.querySelectorAll("#frames article")];
  for (const article of all) article.hidden = !article.textContent.toLowerCase().includes(words);
  const shown = all.filter((article) => !article.hidden).length;
  document.getElementById("found").textContent = words ? `${shown} of ${all.length}` : "";
};
if (find) find.addEventListener("input", select);
for (const link of document.querySelectorAll("[data-find]"))
  link.addEventListener("click", () => { find.value = link.dataset.find; select(); });

const data = document.getElementById("data");
if (data) {
  const {frames, times, pictures, statuses} = JSON.parse(data.textContent);
  const at = document.getElementById("at"), play = document.getElementById("play");
  let timer = 0;
  const show = (k) => {
    at.value = k;
    document.getElementById("shown").src = pictures[k];
    document.getElementById("where").textContent = `${frames[k]}, ${statuses[k]}`;
  };
  const stop = () => { clearTimeout(timer); timer = 0; play.textContent = "play"; };
  const next = () => {
    const k = Number(at.value);
    if (k + 1 >= frames.length) { stop(); return; }
    const still = Math.min(Math.max(1000 * (times[k + 1] - times[k]), 20), 500);
    timer = setTimeout(() => { show(k + 1); next(); }, still);
  };
  play.addEventListener("click", () => {
    if (timer) { stop(); return; }
    if (Number(at.value) + 1 >= frames.length) show(0);
    play.textContent = "stop";
    next();
  });
  at.addEventListener("input", () => { stop(); show(Number(at.value)); });
  const go = (k) => { stop(); show(k); document.getElementById("player").scrollIntoView({block: "nearest"}); };
  for (const button of document.querySelectorAll("[data-seek]")) {
    const k = Number(button.dataset.seek);
    pictures[k] = button.closest("article").querySelector("img").src;
    button.addEventListener("click", () => go(k));
  }
  for (const chart of document.querySelectorAll("[data-seeks]"))
    chart.addEventListener("click", (event) => {
      const [low, high, left, right] = chart.dataset.seeks.split(" ").map(Number);
      const box = chart.getBoundingClientRect();
      const u = (event.clientX - box.left) * chart.viewBox.baseVal.width / box.width;
      const time = low + (u - left) / (right - left) * (high - low);
      const distance = (k) => Math.abs(times[k] - time);
      go(times.reduce((best, _, k) => (distance(k) < distance(best) ? k : best), 0));
    });
  show(0);
}
