"""Browser scripts that pick a trade-off from a drawing or copy the current one.

viser does not report clicks on HTML in a panel. So a pick writes its trade-off into the page's text
field, as if the user had typed it. In the drawing, `data-w` is the trade-off of a point, and
`data-map` is the matrix from a position in the triangle to three weights.
"""

from collections.abc import Sequence
from html import escape

from ...colors import of_objectives
from . import svg
from .weights import Weights, even, show

FIELD = "trade-off"  # the label of the text field

FIND_FIELD = f"""
let field = [...document.querySelectorAll('label')].find(l => l.textContent === '{FIELD}');
if (!field) return;
while (!field.querySelector('input')) field = field.parentElement;
field = field.querySelector('input');
"""
PICK = """
if (event.type === 'pointerdown') {
  this.cell = event.target.closest('[data-cell]');
  this.setPointerCapture(event.pointerId);
} else if (!event.buttons) return;
if (!this.cell) return;
const matrix = this.getScreenCTM().inverse();
const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix);
const away = c => Math.hypot(c.getAttribute('cx') - at.x, c.getAttribute('cy') - at.y);
const points = [...this.cell.querySelectorAll('[data-w]')];
const rows = JSON.parse(this.cell.dataset.map || '[]');
const inside = rows.map(([x, y, one]) => Math.max(0, x * at.x + y * at.y + one));
const total = inside.reduce((a, b) => a + b, 0);
const text = rows.length
  ? inside.map(w => (w / total).toFixed(3)).join(', ')
  : points.reduce((a, b) => away(a) <= away(b) ? a : b).dataset.w;
"""
# React notices a new text only through the browser's native setter and an input event
WRITE = """
Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(field, text);
field.dispatchEvent(new Event('input', {bubbles: true}));
"""
COPY = """
field.select();
document.execCommand('copy');
this.textContent = 'copied';
setTimeout(() => this.textContent = 'copy', 1500);
"""


def handlers() -> dict[str, str]:
    """Return the attributes that make an <svg> pickable, by a click or by dragging."""
    script = PICK + FIND_FIELD + WRITE
    return {"onpointerdown": script, "onpointermove": script}


def buttons(objectives: Sequence[str]) -> str:
    """Return buttons that set the field to a corner or to the balance, or copy it.

    Copying needs neither a permission nor https.
    """
    m = len(objectives)
    corners = [tuple(float(i == k) for i in range(m)) for k in range(m)]
    named = zip(objectives, corners, of_objectives(m), strict=True)
    found = [_set(f"only {name}", corner, _dot(color), name) for name, corner, color in named]
    found.append(_set("all objectives equally", even(m), "", "balance"))
    found.append(
        svg.element("button", "copy", **_button("copy the trade-off"), onclick=FIND_FIELD + COPY)
    )
    style = "display:flex;flex-wrap:wrap;gap:4px;padding:0 0.7em 0.5em"
    return svg.element("div", "".join(found), style=style)


def dot(color: str) -> str:
    """Return a mark in the color of an objective, between the label and the slider that follow."""
    mark = svg.element("span", "", style=f"position:absolute;left:5.6em;top:0.4em;{_disk(color)}")
    return svg.element("div", mark, style="position:relative;height:0")


def _set(hint: str, weights: Weights, mark: str, name: str) -> str:
    script = FIND_FIELD + "const text = this.dataset.w;" + WRITE
    return svg.element(
        "button", mark + escape(name), **_button(hint), data_w=show(weights), onclick=script
    )


def _button(hint: str) -> dict[str, str]:
    style = (
        "border:1px solid #8888;border-radius:1em;background:none;color:inherit;font:inherit;"
        "font-size:0.8em;padding:0.1em 0.7em;cursor:pointer"
    )
    return {"type": "button", "title": hint, "style": style}


def _dot(color: str) -> str:
    return svg.element("span", "", style=f"margin-right:0.4em;{_disk(color)}")


def _disk(color: str) -> str:
    return f"display:inline-block;width:8px;height:8px;border-radius:4px;background:{color}"
