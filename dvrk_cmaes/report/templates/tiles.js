"use strict";
// Of n tiles in rows of equal width, none is left alone in the last row: fewer columns, or a tile of a row's width.
function layTiles(container, fewest) {
  const tiles = [...container.children].filter((tile) => !tile.hidden);
  container.style.gridTemplateColumns = "";
  for (const tile of tiles) tile.classList.remove("alone");
  const most = getComputedStyle(container).gridTemplateColumns.split(" ").length;
  if (tiles.length <= most || most === 1) return;
  let columns = most;
  while (columns > 2 && tiles.length % columns === 1) columns -= 1;
  if (columns < most) container.style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
  if (tiles.length % columns === 1 && columns >= fewest) tiles[tiles.length - 1].classList.add("alone");
}
