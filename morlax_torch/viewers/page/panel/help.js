// All keys of the page, in a dialog.

import { $, html } from "../pictures.js";

const KEYS = [
  ["space", "pause and continue"],
  ["P", "push the robots"],
  ["R", "restart the episode"],
  ["C", "return the camera; arrow keys turn it while the picture has the focus"],
  ["B", "balance: all objectives equally"],
  ["U", "per second, or per episode"],
  ["1 2 3 4", "steer this robot"],
  ["W A S D", "command a velocity; Q and E turn, X stops"],
  ["Tab", "next control: buttons, sliders, front and triangle"],
  ["arrow keys", "move a slider, a policy along the front, or the point in the triangle"],
  ["?", "this list"],
];

/** Show the keys. */
export function help() {
  const rows = KEYS.map(([keys, meaning]) => {
    const names = (keys === "arrow keys" ? [keys] : keys.split(" ")).map((textContent) => html("kbd", { textContent }));
    return html("tr", {}, html("th", {}, ...names), html("td", { textContent: meaning }));
  });
  $("keys").replaceChildren(...rows);
  $("help").showModal();
}
