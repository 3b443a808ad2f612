// Files that the server writes: the chosen policy, and why it was chosen.

const $ = (id) => document.getElementById(id);

export class SavingPanel {
  constructor(engine) {
    this.engine = engine;
    $("export").title = "Write the policy of this trade-off as ONNX, like morlax export";
    $("export").onclick = () => engine.press("export");
    $("card").title = "Try the choice under pushes and other conditions, and write a page about it";
    $("card").onclick = () => engine.press("card");
  }

  show() {
    const { saving, choosing } = this.engine;
    const key = JSON.stringify([saving, Boolean(choosing?.found)]);
    if (key === this.key) return;
    this.key = key;
    $("export").hidden = !saving;
    $("card").hidden = !saving || !choosing?.found;
    $("export").disabled = $("card").disabled = Boolean(saving?.busy);
    $("saved").textContent = saving?.text ?? "";
  }
}
