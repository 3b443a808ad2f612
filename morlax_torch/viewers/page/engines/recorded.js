// A recorded robot, which repeats itself while the page loads the robot itself; see `Local`.

import { arraysOf, unpacked } from "../files.js";

const MOST_DELAY = 0.1; // s to catch up with; the rest of a longer delay is dropped

export class Recorded {
  /** Load the recording of a folder that `pack --web` wrote. */
  static async load(folder) {
    const file = await unpacked(`${folder}/start.bin`);
    return new Recorded(arraysOf(await file.arrayBuffer()));
  }

  constructor({ dt, followed, places, turns, ...model }) {
    Object.assign(this, { model, places, turns, about: { dt, followed }, names: null, scene: {} });
    this.isRecorded = true; // the robot itself follows on the stage
    this.length = places.length / (3 * model.nbody);
    this.due = 0;
    this.#place(0);
  }

  /** Move on a stage that shows this recording, until `ended`. */
  async play(stage, ended) {
    for (let last = performance.now(); ; ) {
      const now = await new Promise(requestAnimationFrame);
      if (ended()) return;
      this.due += Math.min(Math.max(now - last, 0) / 1000, MOST_DELAY);
      last = now;
      for (; this.due >= this.about.dt; this.due -= this.about.dt) {
        this.#place((this.robots[0].steps + 1) % this.length);
        stage.advance();
      }
      stage.draw(this.due / this.about.dt);
    }
  }

  #place(steps) {
    const { nbody } = this.model;
    const part = (numbers, size) => numbers.subarray(size * nbody * steps, size * nbody * (steps + 1));
    this.robots = [{ steps, places: part(this.places, 3), turns: part(this.turns, 4) }];
  }
}
