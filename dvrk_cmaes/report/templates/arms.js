"use strict";
{
  const pictures = document.querySelector(".pictures");
  const lay = () => layTiles(pictures, 2);
  if (pictures) {
    lay();
    addEventListener("resize", lay);
  }
}
