// What stands where: files that were dropped, samples, and where the object is put.

import * as api from "./api.js";
import { clamped } from "./geometry.js";
import { Latest } from "./latest.js";
import * as store from "./store.js";
import { NOTHING, byId, element, slider, tell, toast } from "./ui.js";

const PICTURES = ".png,.jpg,.jpeg,.webp,.exr,.hdr";
const PHOTOS = [".jpg", ".jpeg", ".hdr", ".exr"]; // which are never cut-outs
const MODELS = ".glb,.gltf,.obj";
const ACCEPTS = { photo: `${PICTURES},.zip`, object: `${MODELS},.png,.webp,.jpg,.jpeg,.exr`, mask: PICTURES };
const START = { at: [0.5, 0.8], yaw: 0, size: "", fov: "", horizon: "", camera_height: "", occlusion: false };
const PAUSE_MS = 450; // after the last turn of a slider, before the object is put in anew
const KEY_STEP = 0.01; // of the picture that an arrow key moves the object
const SOURCES = "sources"; // of IndexedDB: files of the present scene, so that a reload can go on

export class SceneDesk {
  /**
   * @param {{entered: (scene, composed: boolean) => void, photo: (file: File) => void}} then
   */
  constructor(then) {
    this.then = then;
    this.making = new Latest((wish, signal) => this.make(wish, signal), (error) => this.failed(error), { interrupts: true });
    this.forget();
    this.build();
  }

  /** Nothing stands here, and nothing is on its way. */
  forget() {
    clearTimeout(this.timer);
    this.making.drop();
    this.files = {};
    this.place = { ...START };
  }

  /** Sort files that were dropped by what they may be; the service looks into them. */
  take(files, wanted = null) {
    this.making.drop(); // what comes now counts
    for (const file of files) {
      const suffix = `.${file.name.toLowerCase().split(".").pop()}`;
      if (suffix === ".zip") return this.replace({ bundle: file }, "Unpacking the scene…");
      if (MODELS.split(",").includes(suffix)) this.files.object = file;
      else if (wanted) this.files[wanted] = file;
      else if (!this.files.photo || (this.files.object && PHOTOS.includes(suffix))) this.files.photo = file;
      else this.files.object = file;
    }
    if (this.files.photo) this.then.photo(this.files.photo, Boolean(this.files.object));
    else if (this.files.object) toast(`${this.files.object.name} is here. Now drop the photograph it is for.`, "note");
    this.showSlots();
    this.putIn();
    return undefined;
  }

  ask(slot) {
    const input = byId("file");
    input.accept = ACCEPTS[slot];
    input.onchange = () => {
      if (input.files.length) this.take([...input.files], slot);
      input.value = "";
    };
    input.click();
  }

  sample(name) {
    this.replace({ sample: name }, "Setting the scene…");
  }

  /** A whole scene instead of what stands here. */
  replace(fields, text) {
    clearTimeout(this.timer);
    this.making.ask({ fields, text });
  }

  /** Make a whole scene of `fields`, or put the object into the photograph as it is placed now. */
  async make({ fields, text }, signal) {
    busy(text);
    try {
      const scene = await api.makeScene(fields ?? this.composition(), signal);
      if (fields) this.forget(); // not before: without a scene the files stay what they are
      else {
        await store.put(SOURCES, { scene: scene.id, files: this.files, place: this.place });
        signal.throwIfAborted(); // by a newer wish, or by starting over
      }
      await this.enter(scene, !fields);
    } finally {
      busy(null);
    }
  }

  composition() {
    const { at, yaw, occlusion, ...others } = this.place;
    return {
      ...this.files, ...others, at: at.map((v) => v.toFixed(4)).join(","), occlusion: String(occlusion),
      yaw: this.cutout ? 0 : yaw, // which is kept for a model that may come instead
    };
  }

  failed(error) {
    tell(error);
    this.showSlots();
  }

  /** Whether the object is a picture, which nothing turns. */
  get cutout() {
    const { object } = this.files;
    return Boolean(object) && !MODELS.split(",").some((suffix) => object.name.toLowerCase().endsWith(suffix));
  }

  /** What a person calls the scene. */
  get title() {
    const { photo, object } = this.files;
    return this.composed ? `${object.name} in ${photo.name}` : this.scene.name || "Scene";
  }

  enter(scene, composed) {
    this.scene = scene;
    this.composed = composed;
    this.showSlots();
    byId("scene-summary").textContent = sentence(scene.summary);
    return this.then.entered(scene, composed);
  }

  /** Go on with a scene of before, its files too if they are still here. */
  async again(id) {
    const scene = await api.scene(id);
    const kept = await store.get(SOURCES);
    const composed = kept?.scene === id;
    this.forget();
    if (composed) Object.assign(this, { files: kept.files, place: { ...START, ...kept.place } });
    this.showPlace();
    await this.enter(scene, composed);
  }

  build() {
    const soon = () => {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.putIn(), PAUSE_MS);
    };
    this.yaw = slider({
      label: "Turn", min: -180, max: 180, step: 1, value: 0, unit: "°",
      changed: (value) => { this.place.yaw = value; soon(); },
    });
    const number = (name, label, rules) => {
      const input = element("input", { type: "number", id: `place-${name}`, placeholder: "auto", ...rules });
      input.addEventListener("change", () => {
        if (!input.checkValidity()) return toast(`${label}: ${input.validationMessage}`);
        this.place[name] = input.value;
        return soon();
      });
      this[name] = input;
      return element("div", { className: "row flat" }, element("label", { htmlFor: input.id }, label), input);
    };
    this.occlusion = element("input", { type: "checkbox", id: "place-occlusion" });
    this.occlusion.addEventListener("change", () => { this.place.occlusion = this.occlusion.checked; soon(); });
    const camera = element("details", { className: "more" }, element("summary", {}, "Camera and floor"),
      number("fov", "Field of view, °", { min: 1, max: 179, step: "any" }),
      number("horizon", "Horizon, 0 top to 1", { min: -10, max: 10, step: 0.01 }),
      number("camera_height", "Camera height, m", { min: 0.01, max: 1000, step: "any" }),
      element("div", { className: "row flat" }, element("label", { htmlFor: "place-occlusion" }, "Nearer things hide it"), this.occlusion));
    byId("place-rows").append(this.yaw.row, number("size", "Size, m", { min: 0.001, max: 1000, step: "any" }), camera);
    byId("spot").addEventListener("click", (event) => this.clicked(event));
    byId("spot").addEventListener("keydown", (event) => this.keyed(event, soon));
    byId("choose-photo").addEventListener("click", () => this.ask("photo"));
    byId("choose-object").addEventListener("click", () => this.ask("object"));
  }

  clicked(event) {
    if (event.detail !== 0) { // not by Enter or Space
      const box = byId("spot").getBoundingClientRect();
      this.stand([(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height]);
    }
    this.putIn();
  }

  /** Compose, once there is something to compose. */
  putIn() {
    if (this.files.photo && this.files.object) this.making.ask({ text: "Putting it in…" });
  }

  keyed(event, soon) {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const step = steps[event.key];
    if (!step) return;
    event.preventDefault();
    this.stand(this.place.at.map((value, i) => value + step[i] * KEY_STEP));
    soon();
  }

  stand(at) {
    this.place.at = at.map((value) => clamped(value, 0, 1));
    this.showPlace();
  }

  showPlace() {
    const { at, yaw } = this.place;
    byId("spot-mark").style.left = `${at[0] * 100}%`;
    byId("spot-mark").style.top = `${at[1] * 100}%`;
    this.yaw.set(yaw);
    for (const name of ["size", "fov", "horizon", "camera_height"]) this[name].value = this.place[name];
    this.occlusion.checked = this.place.occlusion;
  }

  /** Files as they are, each to be replaced. */
  showSlots() {
    const { photo, object } = this.files;
    const names = photo || object ? ["photo", "object", ...(this.cutout ? ["mask"] : [])] : [];
    const titles = { photo: "Photo", object: "Object", mask: "Mask" };
    byId("slots").replaceChildren(...names.map((name) => {
      const file = this.files[name];
      const none = name === "mask" ? "its transparency" : "none yet";
      const button = element("button", { type: "button", className: "quiet" }, file ? "Replace" : "Choose");
      button.setAttribute("aria-label", `${file ? "Replace" : "Choose"} the ${titles[name].toLowerCase()}`);
      button.addEventListener("click", () => this.ask(name));
      return element("li", {}, element("span", { className: "slot" }, titles[name]),
        element("span", { className: "file", title: file?.name ?? "" }, file?.name ?? none), button);
    }));
    byId("place-rows").hidden = !(photo && object);
    this.yaw.row.hidden = this.cutout;
    this.showPlace();
  }
}

/** Cards of the scenes that come along, with pictures as they come. */
export async function offerSamples(names, opened) {
  const cards = names.map((name) => {
    const image = element("img", { alt: "", width: 160, height: 160, src: NOTHING });
    const title = name[0].toUpperCase() + name.slice(1);
    const button = element("button", { type: "button", className: "sample" }, image, element("span", {}, title));
    button.addEventListener("click", () => opened(name));
    byId("samples").append(element("li", {}, button));
    return { name, image };
  });
  byId("samples-title").hidden = names.length === 0;
  for (const { name, image } of cards) {
    const blob = (await store.get(`sample-${name}`)) || (await pictured(name));
    if (blob) image.src = URL.createObjectURL(blob);
  }
}

async function pictured(name) {
  try {
    const scene = await api.makeScene({ sample: name });
    const blob = await api.scenePicture(scene.id);
    await store.put(`sample-${name}`, blob);
    return blob;
  } catch {
    return null; // the card does without
  }
}

let working = 0;

/** Say what is being waited for; null once it is there. */
export function busy(text) {
  working += text === null ? -1 : 1;
  if (text !== null) byId("busy-text").textContent = text;
  byId("busy").hidden = working <= 0;
}

const sentence = (text) => (text ? `${text[0].toUpperCase()}${text.slice(1)}.` : "");
