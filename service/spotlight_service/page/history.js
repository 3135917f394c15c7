// Pictures made so far. The service keeps the jobs; thumbnails are kept here.

import * as api from "./api.js";
import * as store from "./store.js";
import { side } from "./dome.js";
import { NOTHING, byId, display, element, seconds, tell } from "./ui.js";

const SHOWN = 40;
const THUMB = 176; // pixels of the longer side
const WORDS = { queued: "Waiting", running: "Being made", failed: "Failed", cancelled: "Cancelled" };

export class History {
  /** @param {(job) => void} opened */
  constructor(opened) {
    this.opened = opened;
    this.jobs = new Map();
    this.items = new Map();
  }

  async load() {
    try {
      const jobs = await api.jobs(SHOWN);
      for (const job of jobs.toReversed()) this.put(job);
      store.keepOnly("thumb-", new Set(jobs.map((job) => job.id)));
      return jobs;
    } catch (error) {
      tell(error);
      return [];
    }
  }

  /** Take note of a job, or of how it stands now; an answer that an event overtook revives nothing. */
  put(job) {
    const before = this.jobs.get(job.id);
    if (api.ENDS.includes(before?.state) && !api.ENDS.includes(job.state)) return;
    this.jobs.set(job.id, job);
    let item = this.items.get(job.id);
    if (!item) {
      item = this.item(job.id);
      this.items.set(job.id, item);
      byId("history").prepend(item.row);
    }
    item.told.textContent = caption(job);
    item.detail.textContent = WORDS[job.state] || detail(job);
    item.row.dataset.state = job.state;
    const openable = !["failed", "cancelled"].includes(job.state);
    item.button.disabled = !openable;
    item.why.textContent = job.error?.detail ?? "";
    if (job.state === "done" && before?.state !== "done") this.fillThumb(job, item.image);
    byId("history-empty").hidden = this.jobs.size > 0;
  }

  mark(id) {
    for (const [job, item] of this.items) item.button.setAttribute("aria-current", job === id);
  }

  item(id) {
    const image = element("img", { alt: "", className: "thumb", src: NOTHING });
    const told = element("span", { className: "told" });
    const detail = element("span", { className: "hint" });
    const text = element("span", { className: "text" }, told, detail);
    const button = element("button", { type: "button", className: "past" }, image, text);
    button.addEventListener("click", () => this.opened(this.jobs.get(id)));
    const why = element("p", { className: "hint why" }); // beside the button, which is of no use then
    return { row: element("li", {}, button, why), button, image, told, detail, why };
  }

  async fillThumb(job, image) {
    const kept = await store.get(`thumb-${job.id}`);
    if (kept) return display(image, kept);
    try {
      const blob = await smaller(await api.result(job.id, "image/webp"));
      await display(image, blob);
      await store.put(`thumb-${job.id}`, blob);
    } catch {
      // It may have been forgotten meanwhile: the entry does without.
    }
  }
}

async function smaller(blob) {
  const whole = await createImageBitmap(blob);
  const shrink = Math.min(1, THUMB / Math.max(whole.width, whole.height));
  const [width, height] = [whole.width, whole.height].map((side) => Math.max(1, Math.round(side * shrink)));
  const canvas = new OffscreenCanvas(width, height);
  const pen = canvas.getContext("2d");
  pen.imageSmoothingQuality = "high";
  pen.drawImage(whole, 0, 0, width, height);
  return canvas.convertToBlob({ type: "image/webp", quality: 0.85 });
}

/** What a job asked for, in a few words. */
export function caption(job) {
  const { lights, sweep } = job.request;
  if (sweep) return `${lights.length} directions`;
  if (lights.length > 1) return `${lights.length} lights`;
  const [light] = lights;
  if (light.shadow !== undefined) return "Painted shadow";
  return `${sentence(side(light.azimuth))}, ${Math.round(light.elevation)}° up`;
}

const sentence = (text) => text[0].toUpperCase() + text.slice(1);

function detail(job) {
  const at = new Date(job.created).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", hour12: false });
  const plan = job.plan?.name ?? job.request.plan ?? "";
  return [plan, seconds(job.seconds), at].filter(Boolean).join(" · ");
}
