// The dome over the scene on which lights are dragged.

import {
  Camera, add, angles, clamped, cross, direction, dot, floorFrame, meetSphere, scaled, unit, wrapped,
} from "./geometry.js";

const SVG = "http://www.w3.org/2000/svg";
export const LOWEST = 3; // degrees: below, the shadow leaves the picture
export const HIGHEST = 89;
const STEP = 2; // degrees an arrow key moves a light
const STRIDE = 15; // … with shift, or by page up and down
const POINTS = 72; // of a ring
const BEYOND = 0.01; // of the picture, that the dome may reach beyond it
const OVERHANG = 0.05; // of the picture, that a lamp may lie beyond it and still be seen
const LEAST = 0.16; // of the picture's shorter side: a smaller dome is hard to grasp
const ROOMY = 0.8; // of the object's height: the dome is at least as high

export class Dome {
  /**
   * @param {HTMLElement} root lies over the picture
   * @param {(index: number, azimuth: number, elevation: number, settled: boolean) => void} moved
   * @param {(index: number) => void} chosen
   */
  constructor(root, moved, chosen) {
    this.root = root;
    this.moved = moved;
    this.chosen = chosen;
    this.lines = document.createElementNS(SVG, "svg");
    this.lines.setAttribute("aria-hidden", "true");
    root.append(this.lines);
    this.handles = [];
    this.lights = [];
    new ResizeObserver(() => this.draw()).observe(root);
  }

  /** Stand over another scene, as the service describes it. */
  stand(scene) {
    this.frame = floorFrame(scene.floor_normal);
    this.camera = new Camera(scene.width, scene.height, scene.field_of_view);
    const [left, , right, bottom] = scene.object_box;
    // Only directions count, so the distance is free: the dome stands one unit away.
    this.centre = this.camera.ray([(left + right) / 2, bottom - (bottom - scene.object_box[1]) * 0.08]);
    this.radius = this.fitting(scene.object_box);
    this.draw();
  }

  /** The largest dome that stays in the picture, but one that holds the object. */
  fitting([left, top, right, bottom]) {
    const within = (value) => value > -BEYOND && value < 1 + BEYOND;
    let holds = 0.7;
    for (let radius = holds; radius > 0.02; radius *= 0.97) {
      const zenith = this.place(0, 90, radius);
      const foot = this.camera.project(this.centre)[1];
      const small = radius * Math.max(this.camera.fx, this.camera.fy) < LEAST;
      if (small || foot - zenith[1] < ROOMY * (foot - top) || radius * this.camera.fx < (right - left) / 2) break;
      holds = radius;
      const inside = this.ring(0, radius).every((p) => p && p.every(within)) && zenith[1] > 0.04;
      if (inside) break;
    }
    return holds;
  }

  place(azimuth, elevation, radius = this.radius) {
    const towards = direction(this.frame, azimuth, elevation);
    return this.camera.project(add(this.centre, scaled(towards, radius)));
  }

  ring(elevation, radius = this.radius) {
    return Array.from({ length: POINTS + 1 }, (_, i) =>
      this.place((i * 360) / POINTS, elevation, radius));
  }

  /** Whether a light is on the side that a viewer sees of a solid dome. */
  inFront(light) {
    return dot(direction(this.frame, light.azimuth, light.elevation), this.centre) < -this.radius;
  }

  show(lights, selected) {
    this.lights = lights;
    this.selected = selected;
    this.draw();
  }

  draw() {
    if (!this.camera) return;
    const { width, height } = this.root.getBoundingClientRect();
    if (!width) return;
    this.lines.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.lines.replaceChildren();
    const at = (p) => [p[0] * width, p[1] * height];
    this.line("rim", this.outline().map(at));
    this.line("floor", this.ring(0).map(at));
    const light = this.lights[this.selected];
    if (light?.kind === "placed") this.drawGuides(light, at);
    this.drawHandles();
  }

  /** What shows where the selected light is: its height, its foot on the floor, its ray. */
  drawGuides(light, at) {
    const { azimuth, elevation } = light;
    this.line("level", this.ring(elevation).map(at));
    const arc = Array.from({ length: 31 }, (_, i) => this.place(azimuth, i * 3)).map(at);
    this.line("meridian", arc);
    const middle = at(this.camera.project(this.centre));
    this.line("foot", [middle, at(this.place(azimuth, 0))]);
    this.line("beam", [at(this.place(azimuth, elevation)), middle]);
  }

  /** The dome's outline: where rays from the camera touch it, above the floor. */
  outline() {
    const view = unit(this.centre);
    const level = unit(cross(view, this.frame.up));
    const top = cross(level, view);
    const points = [];
    const near = scaled(view, -this.radius); // the centre is one unit away
    const wide = Math.sqrt(1 - this.radius * this.radius);
    for (let i = 0; i <= POINTS; i++) {
      const turn = (i / POINTS) * 2 * Math.PI - Math.PI / 2;
      const across = add(scaled(level, Math.cos(turn)), scaled(top, Math.sin(turn)));
      const towards = add(near, scaled(across, wide));
      if (dot(towards, this.frame.up) < 0) continue;
      points.push(this.camera.project(add(this.centre, scaled(towards, this.radius))));
    }
    return points;
  }

  line(name, points) {
    const path = document.createElementNS(SVG, "path");
    const text = points.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L");
    path.setAttribute("d", `M${text}`);
    path.setAttribute("class", name);
    this.lines.append(path);
  }

  drawHandles() {
    while (this.handles.length > this.lights.length) this.handles.pop().remove();
    while (this.handles.length < this.lights.length) this.handles.push(this.handle(this.handles.length));
    this.lights.forEach((light, index) => {
      const handle = this.handles[index];
      handle.hidden = light.kind !== "placed";
      if (handle.hidden) return;
      const [x, y] = this.place(light.azimuth, light.elevation);
      handle.style.left = `${clamped(x, -OVERHANG, 1 + OVERHANG) * 100}%`;
      handle.style.top = `${clamped(y, -OVERHANG, 1 + OVERHANG) * 100}%`;
      handle.style.setProperty("--lamp", light.colour);
      handle.classList.toggle("selected", index === this.selected);
      handle.classList.toggle("behind", !this.inFront(light));
      const told = describe(light);
      handle.setAttribute("aria-label", this.lights.length > 1 ? `Light ${index + 1}` : "Light");
      handle.setAttribute("aria-valuenow", Math.round(light.azimuth));
      handle.setAttribute("aria-valuetext", told);
    });
  }

  handle(index) {
    const handle = document.createElement("div");
    handle.className = "lamp";
    handle.tabIndex = 0;
    const values = { role: "slider", "aria-valuemin": 0, "aria-valuemax": 360 };
    for (const [name, value] of Object.entries(values)) handle.setAttribute(name, value);
    handle.title = "Drag over the edge of the dome to go round behind";
    handle.addEventListener("pointerdown", (event) => this.grabbed(event, index));
    handle.addEventListener("keydown", (event) => this.keyed(event, index));
    handle.addEventListener("focus", () => this.chosen(index));
    this.root.append(handle);
    return handle;
  }

  grabbed(down, index) {
    if (down.button !== 0) return;
    down.preventDefault();
    const handle = this.handles[index];
    handle.focus({ preventScroll: true });
    handle.setPointerCapture(down.pointerId);
    handle.classList.add("held");
    const box = this.root.getBoundingClientRect();
    const [x, y] = this.place(this.lights[index].azimuth, this.lights[index].elevation);
    // The lamp keeps its place under the finger.
    const off = [down.clientX - box.left - x * box.width, down.clientY - box.top - y * box.height];
    const grip = { front: this.inFront(this.lights[index]), outside: false };
    const move = (event) => {
      const at = [
        (event.clientX - box.left - off[0]) / box.width,
        (event.clientY - box.top - off[1]) / box.height,
      ];
      const { azimuth, elevation } = this.under(at, grip);
      this.moved(index, azimuth, elevation, false);
    };
    const end = () => {
      handle.removeEventListener("pointermove", move);
      handle.classList.remove("held");
      const { azimuth, elevation } = this.lights[index];
      this.moved(index, azimuth, elevation, true);
    };
    handle.addEventListener("pointermove", move);
    handle.addEventListener("lostpointercapture", end, { once: true });
  }

  /**
   * Where on the dome a place in the picture is.
   *
   * A ray meets the dome twice. The side that was grabbed counts, until the pointer leaves the
   * outline: whoever comes back in has gone round to the other side.
   */
  under(at, grip) {
    const ray = this.camera.ray(at);
    const met = meetSphere(ray, this.centre, this.radius);
    if (!met) {
      grip.outside = true;
      return this.above(scaled(ray, dot(ray, this.centre)));
    }
    if (grip.outside) {
      grip.outside = false;
      grip.front = !grip.front;
    }
    const far = scaled(ray, met[1]);
    const farLies = dot(add(far, scaled(this.centre, -1)), this.frame.up) >= 0;
    if (!farLies) grip.front = true; // over the floor before the object there is one side only
    return this.above(grip.front ? scaled(ray, met[0]) : far);
  }

  above(point) {
    const { azimuth, elevation } = angles(this.frame, add(point, scaled(this.centre, -1)));
    return { azimuth, elevation: clamped(elevation, LOWEST, HIGHEST) };
  }

  keyed(event, index) {
    const step = event.shiftKey ? STRIDE : STEP;
    const turn = { ArrowLeft: -step, ArrowRight: step }[event.key] || 0;
    const lift = { ArrowUp: step, ArrowDown: -step, PageUp: STRIDE, PageDown: -STRIDE }[event.key] || 0;
    if (!turn && !lift) return;
    event.preventDefault();
    const { azimuth, elevation } = this.lights[index];
    this.moved(index, wrapped(azimuth + turn), clamped(elevation + lift, LOWEST, HIGHEST), true);
  }
}

const SIDES = ["right", "behind right", "behind", "behind left", "left", "front left", "front", "front right"];

/** Where an azimuth is, in words. */
export const side = (azimuth) => SIDES[Math.round(wrapped(azimuth) / 45) % 8];

/** A light's place in words. */
export function describe({ azimuth, elevation }) {
  return `${side(azimuth)}: azimuth ${Math.round(azimuth)}°, elevation ${Math.round(elevation)}°`;
}
