// The panel beside the robot: trade-off, front, command and episode.

import { FrontPlot } from "./front.js";
import { html, short } from "./pictures.js";
import { Sliders } from "./sliders.js";
import { Triangle } from "./triangle.js";
import { colorOf, moved } from "./weights.js";

const $ = (id) => document.getElementById(id);
const CALM = 0.05; // share of a new reward in the smoothed one
const percent = (weight) => `${Math.round(100 * weight)} %`;

export class Panel {
  /**
   * @param simulation the robot.
   * @param choose called with every trade-off that a visitor chooses.
   * @param settled called when a visitor lets go of a slider or plot.
   */
  constructor(simulation, choose, settled) {
    Object.assign(this, { simulation, choose });
    const { about } = simulation;
    this.names = about.objectives;
    this.rates = this.names.map(() => null);
    const rows = this.names.map((name, i) => {
      return { name, limits: [0, 1], color: colorOf(i), format: percent };
    });
    const move = (index, value) => choose(moved(simulation.tradeoff, index, value));
    this.weights = new Sliders(rows, move, settled);
    $("weights").replaceChildren(...this.weights.elements);
    $("triangle").onpointerup = $("front").onpointerup = settled;
    this.#showCommand(about.command);
    this.#showPlots(about.front);
    this.#tabulate(about);
  }

  /** Show the current trade-off. */
  showTradeoff() {
    const { tradeoff } = this.simulation;
    this.weights.show(tradeoff);
    for (const plot of this.plots) plot.show(tradeoff);
  }

  /** Show returns and rewards of the running episode. */
  showEpisode() {
    const { returns, last, about } = this.simulation;
    this.names.forEach((_, i) => {
      const rate = last ? last.reward[i] / about.dt : null;
      this.rates[i] = rate === null ? null : (1 - CALM) * (this.rates[i] ?? rate) + CALM * rate;
      this.cells[i][0].textContent = amount(returns[i]);
      this.cells[i][1].textContent = rate === null ? "–" : amount(this.rates[i]);
    });
    about.terms.forEach((_, i) => {
      this.termCells[i].textContent = last ? amount(last.terms[i]) : "–";
    });
  }

  #showCommand(command) {
    $("command-section").hidden = !command;
    if (!command) return;
    const { simulation } = this;
    const rows = Object.entries(command.limits).map(([unit, limits]) => {
      const format = (value) => value.toFixed(2);
      return { name: unit, limits, color: "var(--ink)", format };
    });
    const sliders = new Sliders(rows, (index, value) => {
      simulation.command[index] = value;
      sliders.show(simulation.command);
    });
    $("command").replaceChildren(...sliders.elements);
    sliders.show(simulation.command);
  }

  #showPlots(front) {
    const m = this.names.length;
    const triangle = m === 3 ? [new Triangle(this.names, this.choose)] : [];
    $("triangle").replaceChildren(...triangle.map((plot) => plot.element));
    $("axes").hidden = m < 3;
    if (m > 2) $("axes").replaceChildren(...this.#axisChoosers(front));
    this.triangle = triangle;
    $("checkpoint").textContent = `front of ${front.checkpoint}`;
    this.#draw(front, front.pair);
  }

  #draw(front, axes) {
    const plot = new FrontPlot(front, this.names, axes, this.choose);
    $("front").replaceChildren(plot.element);
    this.plots = [...this.triangle, plot];
    this.showTradeoff();
  }

  /** Return two lists of objectives, for the axes of the plot. */
  #axisChoosers(front) {
    const lists = [0, 1].map((first) => {
      const options = this.names.map((name, i) => {
        return new Option(name, i, false, i === front.pair[first]);
      });
      const list = html("select", {}, ...options);
      list.setAttribute("aria-label", first ? "Vertical axis" : "Horizontal axis");
      return list;
    });
    const [across, up] = lists;
    const chosen = () => lists.map((list) => Number(list.value));
    let former = chosen();
    for (const list of lists) {
      list.addEventListener("change", () => {
        if (across.value === up.value) [across.value, up.value] = former.toReversed();
        former = chosen();
        this.#draw(front, former);
      });
    }
    return [across, html("span", { textContent: "and" }), up];
  }

  #tabulate({ terms }) {
    const head = ["", "return", "per second"].map((text) => html("th", { textContent: text }));
    this.cells = this.names.map(() => [html("td"), html("td")]);
    const rows = this.names.map((name, i) => {
      const title = html("th", { textContent: name, className: "objective" });
      title.style.setProperty("--color", colorOf(i));
      return html("tr", {}, title, ...this.cells[i]);
    });
    $("episode").replaceChildren(html("tr", {}, ...head), ...rows);
    this.termCells = terms.map(() => html("td"));
    const details = terms.map((name, i) => {
      return html("tr", {}, html("th", { textContent: name }), this.termCells[i]);
    });
    $("terms").replaceChildren(...details);
  }
}

/** Format a number with about four digits. */
function amount(value) {
  const size = Math.abs(value);
  if (size >= 1e5) return short(value);
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : 2);
}
