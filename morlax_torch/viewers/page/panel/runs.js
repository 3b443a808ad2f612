// The lists of runs and of a run's checkpoints, where a server has them.

const $ = (id) => document.getElementById(id);

export class RunLists {
  constructor(engine) {
    this.engine = engine;
    this.key = null;
    $("run").onchange = () => engine.open($("run").value);
    $("checkpoint-list").onchange = () => engine.open(engine.state.run, $("checkpoint-list").value);
  }

  show() {
    const { runs, run, checkpoints, checkpoint } = this.engine.state;
    const key = JSON.stringify([runs, run, checkpoints, checkpoint]);
    if (key === this.key || !runs) return;
    this.key = key;
    $("title").classList.add("spoken");
    $("run").hidden = false;
    $("run").replaceChildren(...Object.entries(runs).map(([name, label]) => new Option(label, name)));
    $("run").value = run;
    $("checkpoint-list").hidden = checkpoints.length < 2;
    $("checkpoint-list").replaceChildren(...checkpoints.map((name) => new Option(name, name)));
    $("checkpoint-list").value = checkpoint;
  }
}
