// The canvas in the middle: which layers show, how large, and the before/after divider.

import { byId, display } from "./ui.js";

const MOST_ENLARGED = 3; // times; small samples would turn to mush
const CONTEXT = 2.4; // times the object's size that is shown around it from close by

export class Viewer {
  constructor() {
    this.frame = byId("frame");
    this.picture = byId("picture");
    this.base = byId("base");
    this.sketch = byId("sketch");
    this.after = byId("after");
    this.forming = byId("forming");
    this.divider = byId("divider");
    this.size = [1, 1];
    this.box = [0, 0, 1, 1]; // of the object, in fractions
    this.close = false;
    new ResizeObserver(() => this.fit()).observe(this.frame);
    this.divider.addEventListener("input", () => this.divide());
    byId("closer").addEventListener("click", () => this.approach(!this.close));
  }

  /** Take the proportions of a picture of so many pixels. */
  shape(width, height) {
    this.size = [width, height];
    this.fit();
  }

  /** Show the object from close by, or the whole picture. */
  approach(close) {
    this.close = close;
    byId("closer").setAttribute("aria-pressed", close);
    this.fit();
  }

  /** Where in the room there is a picture lies, and how large. */
  fit() {
    const [width, height] = this.size;
    const style = getComputedStyle(this.frame);
    const pads = [style.paddingLeft, style.paddingRight, style.paddingTop, style.paddingBottom].map(parseFloat);
    const room = [this.frame.clientWidth - pads[0] - pads[1], this.frame.clientHeight - pads[2] - pads[3]];
    const sheet = this.picture.classList.contains("sheet");
    const whole = Math.min(room[0] / width, room[1] / height, MOST_ENLARGED);
    const [left, top, right, bottom] = this.box;
    const part = Math.min(1, CONTEXT * Math.max(right - left, bottom - top));
    const factor = Math.max(0, this.close && !sheet ? whole / part : whole);
    const off = (low, high, side) => {
      const spare = Math.max(0, (factor / whole - 1) / 2); // of what is seen, on either side
      const wanted = (0.5 - (low + high) / 2) * (factor / whole);
      return Math.min(spare, Math.max(-spare, wanted)) * side * whole;
    };
    this.picture.style.translate = `${off(left, right, width)}px ${off(top, bottom, height)}px`;
    this.picture.style.width = `${Math.floor(width * factor)}px`;
    this.picture.style.height = `${Math.floor(height * factor)}px`;
  }

  async showBase(blob, told) {
    await display(this.base, blob);
    this.base.alt = told;
  }

  async showSketch(blob) {
    await display(this.sketch, blob);
    this.sketch.hidden = false;
    this.picture.classList.remove("painting");
  }

  hideSketch() {
    this.sketch.hidden = true;
  }

  /** A finished picture; beside the scene's it can be compared, a contact sheet cannot. `another` job's? */
  async showResult(blob, { told, compares, another }) {
    await display(this.after, blob);
    this.after.alt = told;
    this.compares = compares;
    if (!compares) this.shape(this.after.naturalWidth, this.after.naturalHeight);
    if (another) this.divider.value = 50 * (this.box[0] + this.box[2]); // over the object
    this.divide();
  }

  /** The picture as it forms, in the window that is diffused. */
  showForming(url, [left, top, right, bottom]) {
    this.forming.classList.toggle("part", right - left < 1 || bottom - top < 1);
    const percent = (share) => `${share * 100}%`;
    Object.assign(this.forming.style, {
      left: percent(left), top: percent(top), width: percent(right - left), height: percent(bottom - top),
    });
    this.forming.src = url;
    this.forming.hidden = false;
  }

  hideForming() {
    this.forming.hidden = true;
    this.forming.removeAttribute("src");
  }

  /** Show what belongs to a view: "place", "light", "paint" or "result". */
  mode(name, { hasResult = false, casts = true } = {}) {
    const result = name === "result" && hasResult;
    this.picture.dataset.mode = name;
    byId("dome").hidden = name !== "light" || !casts;
    byId("brush").hidden = name !== "paint";
    byId("brush-ring").hidden = true;
    byId("spot").hidden = name !== "place" && name !== "photo";
    this.after.hidden = !result;
    byId("compare").hidden = !result || !this.compares;
    this.picture.classList.toggle("sheet", result && !this.compares);
    this.fit();
    this.divide();
  }

  divide() {
    const share = this.compares ? this.divider.value : 0;
    this.after.style.clipPath = this.compares ? `inset(0 0 0 ${share}%)` : "none";
    byId("knob").style.left = `${share}%`;
    this.divider.setAttribute("aria-valuetext", `${Math.round(share)} percent before`);
    byId("compare").classList.toggle("edge-left", share < 12);
    byId("compare").classList.toggle("edge-right", share > 88);
  }

  notice(text) {
    byId("notice").textContent = text || "";
    byId("notice").hidden = !text;
  }
}
