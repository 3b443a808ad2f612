// The growth of the front: a scrubber over the evaluations of a run, and its hypervolume.

import { $, grid, isNews, lined, onDrag, scale, short, svg, ticks } from "../pictures.js";
import { lowest } from "../tradeoffs.js";

const [LEFT, RIGHT, TOP, BOTTOM] = [50, 368, 8, 82]; // of the axes
const LASTS = 8000; // ms from the first evaluation to the last

export class TrainingPanel {
  constructor(engine) {
    Object.assign(this, { engine, asked: null, began: null }); // null: the present, not playing
    const ask = (index) => {
      this.asked = index === this.present ? null : index;
      this.began = null;
    };
    $("moment").oninput = () => ask(Number($("moment").value));
    $("grow").onclick = () => (this.began = this.began === null ? performance.now() : null);
    const near = ([x]) => ask(lowest(engine.training, ({ numbers: [, seconds] }) => Math.abs(this.across(seconds) - x)));
    onDrag($("growth"), near);
  }

  /** Return the index of the evaluation of the checkpoint that is shown. */
  get present() {
    const fingerprint = this.engine.about.front?.fingerprint;
    const { training } = this.engine;
    const index = training.findIndex((moment) => moment.fingerprint === fingerprint);
    return index < 0 ? training.length - 1 : index;
  }

  get past() {
    return this.engine.training.slice(0, this.asked === null ? this.present : this.asked + 1);
  }

  show() {
    const moments = this.engine.training;
    $("training-section").hidden = moments.length < 2 || !this.engine.about.front;
    if ($("training-section").hidden) return;
    this.#play();
    const at = Math.min(this.asked ?? this.present, moments.length - 1);
    if (!isNews(this, at, moments.length, moments.at(-1).numbers, this.began !== null)) return;
    const [steps, seconds, hypervolume] = moments[at].numbers;
    const text = `${short(seconds)} s, ${short(steps)} steps: hypervolume ${short(hypervolume)}`;
    $("grow").textContent = this.began === null ? "play" : "stop";
    Object.assign($("moment"), { max: moments.length - 1, value: at, ariaValueText: text });
    $("moment").style.setProperty("--share", at / (moments.length - 1));
    $("moment-told").textContent = text;
    this.#draw(moments, at);
  }

  #play() {
    if (this.began === null) return;
    const at = Math.floor(((performance.now() - this.began) / LASTS) * this.present);
    this.asked = at < this.present ? at : null;
    if (this.asked === null) this.began = null;
  }

  /** Draw the hypervolumes of `moments`, whose `numbers` are steps, seconds and hypervolume. */
  #draw(moments, at) {
    const high = Math.max(...moments.map(({ numbers }) => numbers[2])) || 1;
    const end = moments.at(-1).numbers[1] || 1; // s
    this.across = scale([0, end], [LEFT, RIGHT]);
    const y = scale([0, high], [BOTTOM, TOP]);
    const places = moments.map(({ numbers: [, seconds, hypervolume] }) => [this.across(seconds), y(hypervolume)]);
    const times = ticks(0, end).map((value) => [this.across(value), `${short(value)} s`]);
    const [cx, cy] = places[at];
    $("growth").replaceChildren(
      ...grid([LEFT, RIGHT, TOP, BOTTOM], times, [0, high].map((volume) => [y(volume), short(volume)])),
      svg("path", { d: lined(places) }),
      svg("line", { x1: cx, x2: cx, y1: TOP, y2: BOTTOM, class: "cursor" }),
      svg("circle", { cx, cy, r: 4 }),
    );
  }
}
