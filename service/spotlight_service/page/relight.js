// One relight at a time: asked for, watched, cancelled.

import * as api from "./api.js";
import { byId, seconds, tell, toast } from "./ui.js";

const WHOLE = [0, 0, 1, 1];
const AGAIN_MS = 1500; // after a stream broke off

export class Run {
  /**
   * @param {import("./viewer.js").Viewer} viewer
   * @param {{changed: (job) => void, done: (job) => void, turned: () => void}} then
   */
  constructor(viewer, then) {
    this.viewer = viewer;
    this.then = then;
    this.job = null;
    this.cancelling = false;
    byId("cancel").addEventListener("click", () => this.cancel());
  }

  /** Ask for a picture and watch it form. */
  async start(request) {
    this.show("Asking…", null);
    try {
      const job = await api.relight(request);
      this.then.changed(job);
      const watching = this.watch(job);
      if (this.cancelling) this.cancel();
      await watching;
    } catch (error) {
      this.hide();
      tell(error);
    }
  }

  /** A job that is still being asked for is cancelled once it is there. */
  async cancel() {
    this.cancelling = true;
    byId("cancel").disabled = true;
    byId("run-text").textContent = "Cancelling…";
    try {
      if (this.job) this.then.changed(await api.cancel(this.job.id));
    } catch (error) {
      this.goOn();
      if (this.job) this.told(this.job);
      tell(error);
    }
  }

  /** Nobody asks for an end to it, or nobody any longer. */
  goOn() {
    this.cancelling = false;
    byId("cancel").disabled = false;
  }

  /** Stop looking; the job goes on. */
  leave() {
    this.control?.abort();
    this.job = null;
    this.hide();
  }

  /** Watch a job to its end, through broken connections. */
  async watch(job) {
    this.control?.abort();
    const control = (this.control = new AbortController());
    this.job = job;
    this.told(job);
    while (!control.signal.aborted) {
      try {
        for await (const { kind, data } of api.events(job.id, control.signal)) {
          if (this.took(kind, data)) return;
        }
      } catch (error) {
        if (error.name === "AbortError") return;
        if (error.status === 404) {
          this.ended();
          tell(error);
          return;
        }
      }
      if (control.signal.aborted) return;
      byId("run-text").textContent = "The connection broke off; looking again…";
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  /** Take in an event; whether it was the last. */
  took(kind, data) {
    if (kind === "progress") this.progress(data);
    else if (kind === "preview") this.viewer.showForming(data.image, data.window || WHOLE);
    else if (kind === "state") {
      this.job = data;
      this.told(data);
      this.then.changed(data);
    } else if (api.ENDS.includes(kind)) {
      this.ended();
      this.then.changed(data);
      if (kind === "done") this.then.done(data);
      else if (kind === "failed") toast(data.error?.detail || "The relight failed.");
      else toast("Cancelled.", "note");
      return true;
    }
    return false;
  }

  told(job) {
    const left = job.eta_s === null ? "" : `, about ${seconds(job.eta_s)}`;
    if (job.cancelling) this.show("Cancelling at the end of the step…", 0);
    else if (job.state === "queued") {
      const before = job.position === 1 ? "1 job before it" : `${job.position} jobs before it`;
      this.show(job.position ? `Waiting, ${before}${left}` : `Waiting for its turn${left}`, null);
    } else if (!job.progress) {
      const takes = job.plan?.predicted_seconds ?? job.eta_s;
      this.show(takes ? `Looking at the scene, about ${seconds(takes)}` : "Looking at the scene…", null);
    } else this.progress({ ...job.progress, eta_s: job.eta_s });
  }

  progress({ stage, step, steps, light, lights, together, fraction, eta_s: left }) {
    if (this.cancelling) return;
    const numbers = (together.length ? together : [light]).map((number) => number + 1);
    const named = `${numbers.length > 1 ? "Lights" : "Light"} ${numbers.join(" and ")} of ${lights}`;
    const which = lights > 1 ? `${named}, step` : "Step";
    const what = stage === "no shadow" ? "Without shadow, step" : which;
    const time = left ? `, ${seconds(left)} left` : "";
    this.show(`${what} ${step} of ${steps}${time}`, fraction);
  }

  show(text, fraction) {
    byId("run").hidden = false;
    byId("run-text").textContent = text;
    if (fraction === null) byId("run-bar").removeAttribute("value");
    else byId("run-bar").value = fraction;
    if (document.body.classList.contains("running")) return;
    document.body.classList.add("running");
    this.then.turned();
  }

  ended() {
    this.job = null;
    this.hide();
  }

  hide() {
    byId("run").hidden = true;
    this.goOn();
    this.viewer.hideForming();
    document.body.classList.remove("running");
    this.then.turned();
  }
}
