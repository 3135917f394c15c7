// The page: who tells whom. Each part knows its own job; this file knows them all.

import * as api from "./api.js";
import { Dome } from "./dome.js";
import { bindDrops, bindKey, bindTheme } from "./frame.js";
import { History } from "./history.js";
import { Latest } from "./latest.js";
import { Lights, placed } from "./lights.js";
import { Painter } from "./painter.js";
import { Run } from "./relight.js";
import { Result } from "./result.js";
import { SceneDesk, offerSamples } from "./scene.js";
import { Settings } from "./settings.js";
import * as store from "./store.js";
import { byId, display, onRadio, radio, seconds, setRadio, slider, tell, toast } from "./ui.js";
import { Viewer } from "./viewer.js";

const QUICK_SIDE = 256; // pixels of a sketch while a light is dragged
const FINE_SIDE = 768; // … and once it is let go
const LOOK_AGAIN_MS = 2500; // at what the service says of itself, while it starts
const LOOKS = 60;
const DIRECTIONS = 8;

const state = { scene: null, composed: false };

const viewer = new Viewer();
const lights = new Lights(lightsChanged);
const settings = new Settings(predict);
const dome = new Dome(byId("dome"), (...moved) => lights.move(...moved), (index) => lights.choose(index));
const painter = new Painter(byId("brush"), byId("brush-ring"), () => lightsChanged(true));
const desk = new SceneDesk({ entered, photo: showPhoto });
const history = new History((job) => open(job).catch(tell));
const result = new Result(viewer, turned);
const run = new Run(viewer, { changed: (job) => history.put(job), done: finished, turned: predict });
const sketches = new Latest(sketch, tell);

// --- the scene ---------------------------------------------------------------------------------

async function entered(scene, composed) {
  const other = state.scene?.id !== scene.id;
  Object.assign(state, { scene, composed });
  if (other) result.forget();
  store.remember("scene", scene.id);
  byId("desk").dataset.scene = "there";
  byId("where").textContent = `${desk.title} · ${scene.width} × ${scene.height}`;
  for (const [id, hidden] of Object.entries({
    empty: true, asking: true, picture: false, "stage-bar": false, "new-scene": false, "scene-group": false,
  })) byId(id).hidden = hidden;
  byId("asks").disabled = false;
  viewer.hideSketch();
  viewer.box = scene.object_box;
  viewer.shape(scene.width, scene.height);
  dome.stand(scene);
  if (other) lights.enter(scene);
  document.querySelector('input[name="view"][value="place"]').parentElement.hidden = !composed;
  show(composed && radio("view") === "place" ? "place" : "light");
  const blob = await api.scenePicture(scene.id).catch(tell);
  if (state.scene !== scene) return;
  if (blob) await viewer.showBase(blob, "The scene under a plain light");
  lightsChanged(true);
}

/** A photograph that waits for its object, or for being put together. */
async function showPhoto(file, complete) {
  if (!complete && state.scene) clear();
  byId("empty").hidden = true;
  byId("desk").dataset.scene = "photo";
  byId("new-scene").hidden = false;
  byId("scene-group").hidden = false;
  byId("asking").hidden = complete || state.scene !== null;
  if (state.scene !== null) return;
  setRadio("view", "place");
  await display(viewer.base, file);
  const { naturalWidth: width, naturalHeight: height } = viewer.base;
  viewer.base.alt = "The photograph";
  byId("picture").hidden = !width; // some formats only the service can show
  if (width) viewer.shape(width, height);
  viewer.mode("photo");
  byId("stage-hint").textContent = HINTS.place;
}

function startOver() {
  desk.forget();
  clear();
}

function clear() {
  viewer.approach(false);
  run.leave();
  sketches.drop();
  Object.assign(state, { scene: null, composed: false });
  result.forget();
  store.remember("scene", null);
  store.remember("job", null);
  for (const id of ["picture", "stage-bar", "asking", "new-scene", "scene-group", "takeaway", "turn"]) byId(id).hidden = true;
  byId("empty").hidden = false;
  byId("desk").dataset.scene = "none";
  byId("where").textContent = "";
  byId("stage-hint").textContent = "";
  byId("asks").disabled = true;
  history.mark(null);
  predict();
}

// --- lights and their sketch -------------------------------------------------------------------

/** `settled`: null if only another light was chosen, else whether the hand has let go. */
function lightsChanged(settled) {
  if (radio("view") !== "place") show(settled === null && radio("view") === "result" ? "result" : "light");
  dome.show(lights.list, lights.chosen);
  if (settled) lights.keep();
  predict();
  if (settled !== null && state.scene) sketches.ask(settled);
}

async function sketch(settled, signal) {
  const { scene } = state;
  const wanted = await lights.request();
  if (!scene) return;
  if (!wanted.length) {
    viewer.hideSketch();
    viewer.notice("");
    return;
  }
  const started = performance.now();
  const { blob, notice } = await api.sketch(scene.id, wanted, settled ? FINE_SIDE : QUICK_SIDE, signal);
  byId("picture").dataset.sketchMs = Math.round(performance.now() - started);
  if (state.scene !== scene) return;
  await viewer.showSketch(blob);
  viewer.notice(notice);
}

function bindPainter() {
  const size = slider({ label: "Size", min: 1, max: 40, step: 1, value: 8, unit: "%", changed: (v) => { painter.size = v / 100; } });
  const soft = slider({ label: "Softness", min: 0, max: 100, step: 1, value: 40, unit: "%", changed: (v) => { painter.softness = v / 100; } });
  byId("brush-rows").append(size.row, soft.row);
  onRadio("tool", (tool) => { painter.erases = tool === "eraser"; });
  byId("brush").addEventListener("pointerdown", () => byId("picture").classList.add("painting"));
  byId("brush").addEventListener("eraser", () => {
    painter.erases = !painter.erases;
    setRadio("tool", painter.erases ? "eraser" : "brush");
  });
  byId("undo").addEventListener("click", () => painter.undo());
  byId("clear").addEventListener("click", () => painter.clear());
}

// --- what the stage shows ----------------------------------------------------------------------

const HINTS = {
  place: "Click the floor where the object stands. Arrow keys move it, too.",
  light: "Drag the light over the dome, past its edge to go round behind. Arrow keys work, too.",
  paint: "Paint where the shadow falls. Paint over the object's foot, so that the shadow begins there.",
  result: "Drag the divider to compare.",
};

function show(view) {
  setRadio("view", view);
  const drawn = lights.light.kind === "drawn";
  const mode = view === "light" && drawn ? "paint" : view;
  if (state.scene && (view !== "result" || !result.job || viewer.compares)) viewer.shape(state.scene.width, state.scene.height);
  if (mode === "paint" && state.scene) painter.open(lights.light.sheet);
  viewer.mode(mode, { hasResult: result.job !== null, casts: state.scene?.casts });
  const input = document.querySelector('input[name="view"][value="result"]');
  input.disabled = result.job === null;
  byId("takeaway").hidden = view !== "result" || !result.job;
  byId("turn").hidden = byId("takeaway").hidden || !result.sweep;
  byId("stage-hint").textContent = view === "result" && (!viewer.compares || result.sweep) ? "" : HINTS[mode] || "";
}

/** A job of before, with its lights or those that were `kept`. */
async function open(job, kept = null) {
  if (state.scene?.id !== job.scene) {
    try {
      await desk.again(job.scene);
    } catch {
      toast("The scene of this picture is no longer kept. The picture itself is.", "note");
    }
  }
  if (kept) lights.resume(kept);
  else lights.restore(job.request.sweep ? job.request.lights.slice(0, 1) : job.request.lights);
  settings.restore(job.request);
  history.mark(job.id);
  store.remember("job", job.id);
  if (job.state === "done") {
    lights.keep();
    sketches.ask(true);
    await finished(job);
  } else {
    lightsChanged(true);
    await run.watch(job);
  }
}

async function finished(job) {
  try {
    await result.open(job, state.scene?.id === job.scene);
  } catch (error) {
    return tell(error);
  }
  byId("picture").hidden = false;
  byId("stage-bar").hidden = false;
  byId("empty").hidden = true;
  history.mark(job.id);
  store.remember("job", job.id);
  dome.show(lights.list, lights.chosen);
  return show("result");
}

/** Another picture of a sweep is shown: the light is where it was for this one. */
function turned(light) {
  show("result");
  if (!Number.isFinite(light?.azimuth) || lights.light.kind !== "placed") return;
  lights.move(lights.chosen, light.azimuth, light.elevation, null);
  lights.keep();
  sketches.ask(true);
}

// --- asking for pictures -----------------------------------------------------------------------

function swept() {
  const request = placed(lights.light);
  return Array.from({ length: DIRECTIONS }, (_, i) => ({ ...request, azimuth: (i * 360) / DIRECTIONS }));
}

async function ask(sweep) {
  const asked = sweep ? swept() : await lights.request();
  if (!sweep && lights.blank) return toast("Paint a shadow first: it says where the light is.", "note");
  show("light");
  byId("picture").classList.remove("painting");
  return run.start({ scene: state.scene.id, lights: asked, sweep, ...settings.request() });
}

function predict() {
  const free = state.scene !== null && !document.body.classList.contains("running");
  byId("relight").disabled = !free;
  byId("sweep").disabled = !free || lights.light.kind !== "placed";
  const about = settings.predicted(lights.list.length);
  byId("relight-seconds").textContent = about === null ? "" : `about ${seconds(about)}`;
  const sweep = settings.predicted(DIRECTIONS);
  byId("sweep").title = `One sheet with the light at eight azimuths${sweep === null ? "" : `, about ${seconds(sweep)}`}`;
}

// --- the service ----------------------------------------------------------------------------------

/** Follow the service until it is ready and has measured what plans take. */
async function follow() {
  let told;
  for (let look = 0; look < LOOKS; look++) {
    let locked = false; // a key was asked for, and none given
    const failed = (error) => { if (error.status === 401) locked = true; else tell(error); };
    const [capable, ready] = await Promise.all([api.capabilities().catch(failed), api.ready()]);
    if (locked) return;
    byId("health").textContent = ready ? "" : "The model is loading…";
    if (capable) {
      if (!told) offerSamples(capable.samples, (name) => desk.sample(name));
      told = capable;
      lights.most = capable.limits.lights;
      settings.offer(Object.values(capable.plans)[0] || []);
      if (ready && settings.measured) return;
    }
    await new Promise((resolve) => setTimeout(resolve, LOOK_AGAIN_MS));
  }
}

async function resume() {
  const kept = await Lights.kept(); // before anything is kept anew
  const jobs = await history.load();
  const live = jobs.find((job) => ["running", "queued"].includes(job.state));
  const last = live || jobs.find((job) => job.id === store.recall("job") && job.state === "done");
  const scene = store.recall("scene");
  try {
    if (last && (live || last.scene === scene)) await open(last, kept.scene === last.scene ? kept : null);
    else if (scene) {
      await desk.again(scene);
      lights.resume(kept);
      lightsChanged(true);
    }
  } catch (error) {
    if (error.status !== 404) tell(error);
    startOver();
  }
}

onRadio("view", show);
byId("relight").addEventListener("click", () => ask(false));
byId("sweep").addEventListener("click", () => ask(true));
byId("new-scene").addEventListener("click", startOver);
bindPainter();
bindDrops((files) => desk.take(files));
bindTheme();
bindKey();
predict();
follow();
resume();
