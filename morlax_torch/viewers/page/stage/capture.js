// Pictures and clips of the stage, with the names above its robots.

const RATE = 30; // frames/s
const FORMATS = ["video/mp4", "video/webm"]; // the first that the browser can write

/** Copies the stage to a canvas of its own, since the names are not part of the drawing. */
export class Capture {
  /** `view` is the stage's canvas, copied right after it has drawn; `labels` has the names. */
  constructor(view, labels) {
    Object.assign(this, { view, labels, recorder: null, canvas: document.createElement("canvas") });
  }

  /** Return the present drawing as a PNG file's data. */
  picture() {
    this.#size();
    this.copy();
    return new Promise((resolve) => this.canvas.toBlob(resolve));
  }

  /** Start a clip, which gets every drawing that is copied from now on. */
  record() {
    this.#size();
    const mimeType = FORMATS.find((format) => MediaRecorder.isTypeSupported(format));
    this.recorder = new MediaRecorder(this.canvas.captureStream(RATE), { mimeType });
    this.recorder.start();
  }

  /** End the clip, and return it as a file's data. */
  end() {
    const { recorder } = this;
    this.recorder = null;
    return new Promise((resolve) => {
      recorder.ondataavailable = ({ data }) => resolve(data); // comes once
      recorder.stop();
    });
  }

  copy() {
    const { canvas, view, labels } = this;
    const context = canvas.getContext("2d");
    context.drawImage(view, 0, 0, canvas.width, canvas.height);
    const scale = canvas.width / view.clientWidth;
    const origin = view.getBoundingClientRect();
    context.setTransform(scale, 0, 0, scale, 0, 0);
    for (const label of labels.children) drawLabel(context, label, origin);
    context.setTransform(1, 0, 0, 1, 0, 0);
  }

  /** Take the size of the drawing, between clips; videos need even numbers. */
  #size() {
    if (this.recorder) return;
    this.canvas.width = 2 * Math.ceil(this.view.width / 2);
    this.canvas.height = 2 * Math.ceil(this.view.height / 2);
  }
}

function drawLabel(context, label, origin) {
  const style = getComputedStyle(label);
  const { x, y, width, height } = label.getBoundingClientRect();
  context.fillStyle = style.backgroundColor;
  context.beginPath();
  context.roundRect(x - origin.x, y - origin.y, width, height, height / 2);
  context.fill();
  context.fillStyle = style.color;
  context.font = style.font;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(label.textContent, x - origin.x + width / 2, y - origin.y + height / 2);
}
