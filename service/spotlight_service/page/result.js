// A finished picture: shown, leafed through where it is a sweep, taken away.

import * as api from "./api.js";
import { side } from "./dome.js";
import { Latest } from "./latest.js";
import { byId, save, tell } from "./ui.js";

const SUFFIXES = { "image/png": "png", "image/jpeg": "jpg", "image/webp": "webp", "image/x-exr": "exr" };

export class Result {
  /**
   * @param {import("./viewer.js").Viewer} viewer
   * @param {(light: ?object) => void} shown called with the light whose picture of a sweep is shown
   */
  constructor(viewer, shown) {
    this.viewer = viewer;
    this.shown = shown;
    this.job = null;
    this.light = null; // of a sweep whose sheet is not shown
    this.turns = new Latest((light) => this.turn(light), (error) => this.stay(error));
    byId("direction").addEventListener("input", () => this.asked());
    byId("download").addEventListener("click", () => this.take().catch(tell));
    byId("download-report").addEventListener("click", () => this.takeReport().catch(tell));
  }

  /** Show a job's picture; `comparable` if the scene shown is the job's. */
  async open(job, comparable) {
    const blob = await api.result(job.id);
    this.turns.drop();
    Object.assign(this, { job, comparable, light: null, kept: new Map([[null, blob]]) });
    byId("direction").max = job.request.lights.length;
    byId("direction").value = 0;
    await this.show(blob, true);
  }

  forget() {
    this.turns.drop();
    this.job = null;
  }

  get sweep() {
    return Boolean(this.job?.request.sweep);
  }

  async show(blob, another = false) {
    const sheet = this.sweep && this.light === null;
    const told = sheet ? "Contact sheet of all directions" : "The relit picture";
    await this.viewer.showResult(blob, { told, compares: !sheet && this.comparable, another });
    this.tell();
  }

  /** The slider's first place is the sheet, the others are the lights in turn. */
  asked() {
    const at = Number(byId("direction").value);
    this.turns.ask(at ? at - 1 : null);
    this.tell(at ? at - 1 : null);
  }

  async turn(light) {
    const { job } = this;
    if (!this.kept.has(light)) {
      const blob = await api.result(job.id, "image/png", light);
      if (this.job !== job) return;
      this.kept.set(light, blob);
    }
    this.light = light;
    await this.show(this.kept.get(light));
    this.shown(light === null ? null : job.request.lights[light]);
  }

  /** One that is no longer there: what is shown stays. */
  stay(error) {
    byId("direction").value = this.light === null ? 0 : this.light + 1;
    this.tell();
    tell(error);
  }

  tell(light = this.light) {
    const text = light === null ? "All on a sheet" : place(this.job.request.lights[light], light);
    byId("direction-told").textContent = text;
    byId("direction").setAttribute("aria-valuetext", text);
    byId("direction").style.setProperty("--share", byId("direction").value / byId("direction").max);
  }

  async take() {
    const kind = byId("format").value;
    save(await api.result(this.job.id, kind, this.light), `${this.name}.${SUFFIXES[kind]}`);
  }

  async takeReport() {
    const text = JSON.stringify(await api.report(this.job.id), null, 2);
    save(new Blob([text], { type: "application/json" }), `${this.name}.json`);
  }

  get name() {
    return `spotlight-${this.job.id.slice(0, 8)}${this.light === null ? "" : `-${this.light}`}`;
  }
}

function place({ azimuth }, light) {
  return azimuth === undefined || azimuth === null ? `Light ${light + 1}` : `${Math.round(azimuth)}°, ${side(azimuth)}`;
}
