"""Browser scripts that pick a trade-off from a drawing or copy the current one.

viser does not report clicks on HTML in a panel. So a pick writes its trade-off into the page's text
field, as if the user had typed it. In the drawing, `data-w` is the trade-off of a point, and
`data-map` is the matrix from a position in the triangle to three weights.
"""

from . import svg

FIELD = "trade-off"  # the label of the text field

FIND_FIELD = f"""
let field = [...document.querySelectorAll('label')].find(l => l.textContent === '{FIELD}');
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
setTimeout(() => this.textContent = 'copy trade-off', 1500);
"""


def handlers() -> dict[str, str]:
    """Return the attributes that make an <svg> pickable, by a click or by dragging."""
    script = PICK + FIND_FIELD + WRITE
    return {"onpointerdown": script, "onpointermove": script}


def copy_button() -> str:
    """Return a button that copies the text field; it needs neither a permission nor https."""
    style = (
        "width:100%;height:2em;border:1px solid #ced4da;border-radius:4px;background:none;"
        "color:inherit;font:inherit;font-size:0.85em;cursor:pointer"
    )
    button = svg.element(
        "button", "copy trade-off", type="button", style=style, onclick=FIND_FIELD + COPY
    )
    return svg.element("div", button, style="padding:0 0.7em 0.5em")
