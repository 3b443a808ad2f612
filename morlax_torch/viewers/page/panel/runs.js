// What a server adds: the lists of runs and of a run's checkpoints, and files that it writes.

import { $, isNews } from "../pictures.js";

const WIDE = 26; // characters of a run's name that a phone shows

export class RunLists {
  constructor(engine) {
    this.engine = engine;
    $("run").onchange = () => this.#open($("run").value);
    $("checkpoint-list").onchange = () => this.#open(engine.state.run, $("checkpoint-list").value);
  }

  /** Ask for another run; until it has come, the lists say what is shown. */
  #open(run, checkpoint) {
    this.engine.open(run, checkpoint);
    this.facts = null;
  }

  show() {
    const { runs, run, checkpoints, checkpoint } = this.engine.state;
    if (!runs || !isNews(this, runs, run, checkpoints, checkpoint)) return;
    $("run").hidden = false;
    const labels = shortened(Object.values(runs));
    const options = Object.entries(runs).map(([name, label], i) => {
      // another label says why the run cannot be shown
      return Object.assign(new Option(labels[i], name), { disabled: label !== name });
    });
    $("run").replaceChildren(...options);
    $("run").value = $("run").title = run;
    $("checkpoint-list").hidden = checkpoints.length < 2;
    $("checkpoint-list").replaceChildren(...checkpoints.map((name) => new Option(name, name)));
    $("checkpoint-list").value = checkpoint;
  }
}

/** Leave out folders that long names begin with, as far as the names stay distinct. */
function shortened(names) {
  const isDistinct = (end) => names.filter((name) => `/${name}`.endsWith(`/${end}`)).length === 1;
  return names.map((name) => {
    const ends = [...name.matchAll("/")].map(({ index }) => name.slice(index + 1)).filter(isDistinct);
    const end = ends.find(({ length }) => length <= WIDE) ?? ends.at(-1);
    return name.length > WIDE && end ? `…/${end}` : name;
  });
}

/** Offer to write files, and tell what was written. */
export function showSaving({ saving, choosing }) {
  if (!isNews($("saved"), saving, Boolean(choosing?.found))) return;
  $("export").hidden = !saving;
  $("card").hidden = !saving || !choosing?.found;
  $("export").disabled = $("card").disabled = Boolean(saving?.busy);
  $("saved").textContent = saving?.text ?? "";
}
