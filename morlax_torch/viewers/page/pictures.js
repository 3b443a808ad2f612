// Elements of the page, and axes.

const SVG = "http://www.w3.org/2000/svg";

export const $ = (id) => document.getElementById(id);

export function svg(name, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

export function html(name, properties = {}, ...children) {
  const element = Object.assign(document.createElement(name), properties);
  element.append(...children);
  return element;
}

/** Return whether facts differ from those of the last call for this part of the page. */
export function isNews(part, ...facts) {
  const former = part.facts;
  part.facts = JSON.stringify(facts);
  return part.facts !== former;
}

/** Make a round button with a text, and a dot of a color if there is one. */
export function chip(text, title, act, color = null) {
  const look = color === null ? {} : { className: "dot", style: `--color: ${color}` };
  const button = html("button", { type: "button", textContent: text, title, ...look });
  button.addEventListener("click", act);
  return button;
}

/** Replace what a part of the page shows; the button with the focus keeps it, or its first one gets it. */
export function renew(part, children) {
  const focused = part.contains(document.activeElement) && document.activeElement.title;
  part.replaceChildren(...children);
  if (focused === false) return;
  const former = part.querySelector(`button[title="${CSS.escape(focused)}"]`);
  (former ?? part.querySelector("button"))?.focus();
}

/** Show another icon of index.html on a button. */
export const setIcon = (button, name) => button.querySelector("use").setAttribute("href", `#icon-${name}`);

/** Call `choose([x, y], begins)`, in the drawing's own units, where a visitor clicks or drags, else `hover`. */
export function onDrag(drawing, choose, hover = () => {}) {
  const place = (event) => {
    const point = new DOMPoint(event.clientX, event.clientY);
    const { x, y } = point.matrixTransform(drawing.getScreenCTM().inverse());
    return [x, y];
  };
  drawing.onpointerdown = (event) => {
    drawing.setPointerCapture(event.pointerId);
    choose(place(event), true);
  };
  drawing.onpointermove = (event) => (event.buttons ? choose : hover)(place(event), false);
}

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/** Call `move(right, up)` when a visitor presses an arrow key on an element that has the focus. */
export function onArrows(element, move) {
  element.onkeydown = (event) => {
    if (!(event.key in ARROWS)) return;
    event.preventDefault();
    move(...ARROWS[event.key]);
  };
}

/** Return the linear map of one range to another. */
export const scale = ([low, high], [from, to]) => (value) => from + ((value - low) / (high - low)) * (to - from);

/** Return the path of a line through places [x, y]. */
export const lined = (places) => places.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");

/** Return the path of dots at places [x, y]. */
export const dotted = (places) => places.map((place) => `${lined([place])}h0`).join("");

/** Return round numbers within [low, high], about `count` of them. */
export function ticks(low, high, count = 4) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 2.5, 5, 10].find((factor) => factor * power >= rough);
  const first = Math.ceil(low / step);
  const marks = [];
  for (let i = first; i * step <= high; i++) marks.push(i * step);
  return marks;
}

/** Draw the grid of two axes within [left, right, top, bottom]; a mark is its place and its text. */
export function grid([left, right, top, bottom], across, up) {
  return [
    ...across.map(([x]) => svg("line", { x1: x, x2: x, y1: top, y2: bottom, class: "grid" })),
    ...across.map(([x, text]) => svg("text", { x, y: bottom + 15, "text-anchor": "middle" }, text)),
    ...up.map(([y]) => svg("line", { x1: left, x2: right, y1: y, y2: y, class: "grid" })),
    ...up.map(([y, text]) => svg("text", { x: left - 6, y: y + 4, "text-anchor": "end" }, text)),
  ];
}

/** Format a number for a tick: 2500 is 2.5k. */
export function short(value) {
  for (const [size, letter] of [[1e9, "G"], [1e6, "M"], [1e3, "k"]]) {
    if (Math.abs(value) >= size) return `${Number((value / size).toPrecision(3))}${letter}`;
  }
  return `${Number(value.toPrecision(3))}`;
}

/** Format a number with about four digits; a dash if it is unknown. */
export function amount(value) {
  const size = Math.abs(value);
  if (!Number.isFinite(size)) return "–";
  return size >= 1e5 ? short(value) : value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : 2);
}

/** Format a share; one that is not zero is not shown as zero. */
export const percent = (share) => `${share > 0 && share < 0.01 ? "<1" : Math.round(100 * share)} %`;
