// The lights: a list, the chips that choose one, and the sliders of the chosen one.

import { LOWEST, HIGHEST } from "./dome.js";
import { wrapped } from "./geometry.js";
import { Painter, coverageOf, drawingOf } from "./painter.js";
import * as store from "./store.js";
import { byId, element, onRadio, setRadio, slider } from "./ui.js";

const FIRST = {
  kind: "placed", azimuth: 135, elevation: 45, radius: 1, distance: 10, weight: 1, colour: "#ffffff",
  far: false, spread: 0.27, // infinitely far away, and then half the angle under which it is seen: the sun's
};
const DRAWINGS = "drawings"; // of IndexedDB
const APART = 120; // degrees from the last light at which another is added

export class Lights {
  /** @param {(settled: boolean) => void} changed */
  constructor(changed) {
    this.changed = changed;
    this.list = [{ ...FIRST }];
    this.chosen = 0;
    this.most = 16;
    this.scene = null;
    this.build();
    this.refresh();
  }

  get light() {
    return this.list[this.chosen];
  }

  get drawn() {
    return this.list.some((light) => light.kind === "drawn");
  }

  get blank() {
    return this.list.some((light) => light.kind === "drawn" && light.sheet.blank);
  }

  /** Another scene: drawings were of the old one. */
  enter(scene) {
    this.scene = scene;
    for (const light of this.list) {
      light.sheet = null;
      if (!scene.casts) light.kind = "drawn";
      if (light.kind === "drawn") light.sheet = Painter.sheet(scene);
    }
    document.querySelector('input[name="kind"][value="placed"]').disabled = !scene.casts;
    this.refresh();
  }

  choose(index) {
    if (index === this.chosen) return;
    this.chosen = index;
    this.refresh();
    this.changed(null);
  }

  move(index, azimuth, elevation, settled) {
    Object.assign(this.list[index], { azimuth, elevation });
    if (index === this.chosen) this.fill();
    this.changed(settled);
  }

  /** Lights of an earlier request; drawings are not kept by the service. */
  restore(entries) {
    const known = entries.filter((entry) => entry.azimuth !== undefined && entry.azimuth !== null);
    if (!known.length) return;
    this.list = known.slice(0, this.most).map(({ azimuth, elevation, radius, distance, weight, colour }) => ({
      ...FIRST, azimuth, elevation, weight, colour: hexOf(colour),
      ...(distance === null ? { far: true, spread: radius } : { radius, distance }),
    }));
    this.chosen = 0;
    this.refresh();
  }

  /** Keep them for a reload: facts where that is done at once, drawings where there is room. */
  keep() {
    const scene = this.scene?.id;
    store.remember("lights", { scene, list: this.list.map(({ sheet, ...facts }) => facts) });
    if (this.drawn) store.put(DRAWINGS, { scene, drawings: this.list.map(({ sheet }) => sheet && coverageOf(sheet)) });
  }

  /** What `keep` kept. */
  static async kept() {
    const { scene, list = [] } = store.recall("lights", {});
    const drawn = list.some((light) => light.kind === "drawn") && (await store.get(DRAWINGS));
    return { scene, list, drawings: drawn?.scene === scene ? drawn.drawings : [] };
  }

  /** Go on with what was kept, in the scene it was kept for. */
  resume({ scene, list, drawings }) {
    if (!list.length || this.scene?.id !== scene) return;
    this.list = list.map((facts, i) => {
      const light = { ...FIRST, ...facts };
      if (light.kind === "drawn") light.sheet = Painter.sheet(this.scene, drawings[i]);
      return light;
    });
    this.chosen = 0;
    this.refresh();
  }

  /** As requests have them; drawings not begun are left out. */
  async request() {
    const made = await Promise.all(this.list.map(async (light) => {
      const mixed = { weight: light.weight, colour: linearOf(light.colour) };
      if (light.kind === "placed") return { ...placed(light), ...mixed };
      return light.sheet.blank ? null : { shadow: await drawingOf(light.sheet), ...mixed };
    }));
    return made.filter(Boolean);
  }

  build() {
    const bind = (name) => (value, settled) => {
      this.light[name] = value;
      this.changed(settled);
    };
    this.rows = {
      azimuth: slider({ label: "Azimuth", min: 0, max: 360, step: 1, value: 0, unit: "°", changed: bind("azimuth") }),
      elevation: slider({ label: "Elevation", min: LOWEST, max: HIGHEST, step: 1, value: 45, unit: "°", changed: bind("elevation") }),
      radius: slider({ label: "Softness", min: 0, max: 5, step: 0.05, value: 1, unit: "×", changed: bind("radius") }),
      spread: slider({ label: "Softness", min: 0, max: 20, step: 0.01, value: 0.27, unit: "°", changed: bind("spread") }),
      distance: slider({ label: "Distance", min: 1, max: 30, step: 0.5, value: 10, unit: "×", changed: bind("distance") }),
      weight: slider({ label: "Weight", min: 0, max: 3, step: 0.05, value: 1, changed: bind("weight") }),
    };
    this.told = element("p", { className: "hint" });
    const { azimuth, elevation, radius, spread, distance, weight } = this.rows;
    byId("placed-rows").append(...[azimuth, elevation, radius, spread, distance].map((each) => each.row), this.told);
    onRadio("reach", (reach) => {
      this.light.far = reach === "far";
      this.fill();
      this.changed(true);
    });
    this.colour = element("input", { type: "color", id: "light-colour", value: "#ffffff" });
    this.colour.addEventListener("input", () => { this.light.colour = this.colour.value; this.refresh(); this.changed(false); });
    this.colour.addEventListener("change", () => this.changed(true));
    const colour = element("div", { className: "row flat" }, element("label", { htmlFor: "light-colour" }, "Colour"), this.colour);
    byId("mix-rows").append(weight.row, colour);
    onRadio("kind", (kind) => this.become(kind));
    byId("add-light").addEventListener("click", () => this.grow());
    byId("remove-light").addEventListener("click", () => this.shrink());
  }

  become(kind) {
    this.light.kind = kind;
    if (kind === "drawn" && !this.light.sheet) this.light.sheet = Painter.sheet(this.scene);
    this.refresh();
    this.changed(true);
  }

  grow() {
    const azimuth = wrapped(this.list.at(-1).azimuth + APART);
    const added = { ...FIRST, azimuth };
    if (this.scene && !this.scene.casts) Object.assign(added, { kind: "drawn", sheet: Painter.sheet(this.scene) });
    this.list.push(added);
    this.chosen = this.list.length - 1;
    this.refresh();
    this.changed(true);
  }

  shrink() {
    this.list.splice(this.chosen, 1);
    this.chosen = Math.max(0, this.chosen - 1);
    this.refresh();
    byId("light-chips").querySelector("[aria-pressed=true]")?.focus();
    this.changed(true);
  }

  /** Show the list as it is. */
  refresh() {
    const several = this.list.length > 1;
    byId("light-chips").replaceChildren(...(several ? this.list.map((light, index) => {
      const dot = element("span", { className: "dot" });
      dot.style.setProperty("--lamp", light.colour);
      const chip = element("button", { type: "button", className: "chip" }, dot, String(index + 1));
      chip.setAttribute("aria-label", `Light ${index + 1}`);
      chip.setAttribute("aria-pressed", index === this.chosen);
      chip.addEventListener("click", () => {
        this.choose(index);
        byId("light-chips").children[index].focus();
      });
      return chip;
    }) : []));
    byId("remove-light").hidden = !several;
    byId("mix-rows").hidden = !several;
    byId("add-light").disabled = this.list.length >= this.most;
    byId("placed-rows").hidden = this.light.kind !== "placed";
    byId("drawn-rows").hidden = this.light.kind !== "drawn";
    setRadio("kind", this.light.kind);
    this.fill();
  }

  fill() {
    for (const [name, row] of Object.entries(this.rows)) row.set(this.light[name]);
    const { far } = this.light;
    setRadio("reach", far ? "far" : "near");
    for (const name of ["radius", "distance"]) this.rows[name].row.hidden = far;
    this.rows.spread.row.hidden = !far;
    this.told.textContent = far
      ? "Infinitely far away, its rays parallel. Softness is half its angle in the sky; the sun's is 0.27°."
      : "Softness is the light's size, in sizes of the object; so is its distance.";
    this.colour.value = this.light.colour;
  }
}

/** A placed light as requests have it. */
export function placed({ azimuth, elevation, far, spread, radius, distance }) {
  return far ? { azimuth, elevation, radius: spread, distance: null } : { azimuth, elevation, radius, distance };
}

const channels = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
const decoded = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
const encoded = (v) => (v <= 0.0031308 ? v * 12.92 : 1.055 * v ** (1 / 2.4) - 0.055);

/** Linear red, green, blue of a picked colour. */
export const linearOf = (hex) => channels(hex).map((value) => Number(decoded(value).toFixed(5)));

export function hexOf(linear) {
  const bytes = linear.map((v) => Math.round(Math.min(1, Math.max(0, encoded(v))) * 255));
  return `#${bytes.map((v) => v.toString(16).padStart(2, "0")).join("")}`;
}
