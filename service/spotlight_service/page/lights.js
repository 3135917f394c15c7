// The lights: a list, the chips that choose one, and the sliders of the chosen one.

import { LOWEST, HIGHEST } from "./dome.js";
import { wrapped } from "./geometry.js";
import { Painter, drawingOf } from "./painter.js";
import { byId, element, onRadio, setRadio, slider } from "./ui.js";

const FIRST = { kind: "placed", azimuth: 135, elevation: 45, radius: 1, distance: 10, weight: 1, colour: "#ffffff" };
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
    const placed = entries.filter((entry) => entry.azimuth !== undefined && entry.azimuth !== null);
    if (!placed.length) return;
    this.list = placed.slice(0, this.most).map((entry) => ({
      ...FIRST,
      azimuth: entry.azimuth, elevation: entry.elevation, radius: entry.radius,
      distance: entry.distance ?? FIRST.distance, weight: entry.weight, colour: hexOf(entry.colour),
    }));
    this.chosen = 0;
    this.refresh();
  }

  /** Placed lights in the way `restore` takes them. */
  entries() {
    const placed = this.list.filter((light) => light.kind === "placed");
    return placed.map(({ sheet, ...light }) => ({ ...light, colour: linearOf(light.colour) }));
  }

  /** As requests have them; drawings not begun are left out. */
  async request() {
    const made = await Promise.all(this.list.map(async (light) => {
      const mixed = { weight: light.weight, colour: linearOf(light.colour) };
      if (light.kind === "placed") {
        const { azimuth, elevation, radius, distance } = light;
        return { azimuth, elevation, radius, distance, ...mixed };
      }
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
      distance: slider({ label: "Distance", min: 1, max: 30, step: 0.5, value: 10, unit: "×", changed: bind("distance") }),
      weight: slider({ label: "Weight", min: 0, max: 3, step: 0.05, value: 1, changed: bind("weight") }),
    };
    const told = element("p", { className: "hint" }, "Softness is the light's size, in sizes of the object; so is its distance.");
    const { azimuth, elevation, radius, distance, weight } = this.rows;
    byId("placed-rows").append(...[azimuth, elevation, radius, distance].map((each) => each.row), told);
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
    this.colour.value = this.light.colour;
  }
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
