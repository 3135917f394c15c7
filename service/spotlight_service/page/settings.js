// How a picture is to look, and how long it may take.

import { byId, element, radio, seconds, setRadio, slider } from "./ui.js";

const USUAL_PLAN = "balanced";
const LATER_SHARE = 2 / 3; // of the first light's time: the pass without shadow is shared
const TITLES = { exact: "Exact", balanced: "Balanced", draft: "Draft" };
const MOST_SEED = 2 ** 31;

export class Settings {
  /** @param {() => void} changed */
  constructor(changed) {
    this.changed = changed;
    this.plans = [];
    const row = (name, given) => (this[name] = slider({ ...given, changed }));
    byId("look-rows").append(
      row("gamma", { label: "Shading γ", min: 0, max: 20, step: 0.1, value: 3, hint: "How strongly the shadow steers the light on the object." }).row,
      row("beta", { label: "Shadow β", min: 0, max: 1, step: 0.01, value: 0.05, hint: "How strongly the shadow itself enters the picture." }).row,
      this.seedRow(),
    );
    this.budget = slider({ label: "At most", min: 1, max: 120, step: 1, value: 10, unit: "s", changed });
    byId("budget-row").append(this.budget.row);
  }

  seedRow() {
    this.seed = element("input", { type: "number", id: "seed", min: 0, max: MOST_SEED, step: 1, value: 469 });
    this.seed.addEventListener("change", () => {
      if (!this.seed.checkValidity() || this.seed.value === "") this.seed.value = 469;
    });
    const other = element("button", { type: "button", className: "quiet" }, "Another");
    other.addEventListener("click", () => (this.seed.value = Math.floor(Math.random() * 100_000)));
    return element("div", { className: "row flat" }, element("label", { htmlFor: "seed" }, "Seed"), this.seed, other);
  }

  /** Offer what the service can do; asked again while its times are still being measured. */
  offer(plans) {
    const before = radio("plan") || USUAL_PLAN;
    this.plans = plans;
    const choices = [...plans, { name: "budget", summary: "as good as the time allows" }];
    byId("plans").replaceChildren(...choices.map(({ name, summary, seconds: takes }) => {
      const input = element("input", { type: "radio", name: "plan", value: name });
      input.addEventListener("change", () => {
        this.show();
        byId("budget-row").scrollIntoView({ block: "nearest" });
      });
      const time = name === "budget" ? "" : takes === null ? "measuring" : `${seconds(takes)}`;
      return element("label", { className: "plan" }, input,
        element("span", { className: "plan-name" }, TITLES[name] || (name === "budget" ? "Time budget" : name)),
        element("span", { className: "plan-time" }, time),
        element("span", { className: "hint" }, summary));
    }));
    setRadio("plan", before);
    if (!radio("plan")) setRadio("plan", plans[0]?.name ?? "budget");
    this.show();
  }

  show() {
    byId("budget-row").hidden = radio("plan") !== "budget";
    this.changed();
  }

  get measured() {
    return this.plans.length > 0 && this.plans.every((plan) => plan.seconds !== null);
  }

  /** Seconds a request of so many pictures is likely to take; null while nobody knows. */
  predicted(lights) {
    const name = radio("plan");
    if (name === "budget") return this.budget.get();
    const takes = this.plans.find((plan) => plan.name === name)?.seconds;
    return takes === null || takes === undefined ? null : takes * (1 + (lights - 1) * LATER_SHARE);
  }

  request() {
    const name = radio("plan");
    const time = name === "budget" ? { budget_s: this.budget.get() } : { plan: name };
    return { ...time, gamma: this.gamma.get(), beta: this.beta.get(), seed: Number(this.seed.value) };
  }

  restore({ plan, budget_s: budget, options = {} }) {
    if (budget) {
      setRadio("plan", "budget");
      this.budget.set(budget);
    } else setRadio("plan", plan || "exact");
    for (const name of ["gamma", "beta"]) if (options[name] !== undefined) this[name].set(options[name]);
    if (options.seed !== undefined) this.seed.value = options.seed;
    this.show();
  }
}
