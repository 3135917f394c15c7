// Painting a shadow over the picture.

import { clamped } from "./geometry.js";

const MOST_SIDE = 1536; // pixels; the service stretches what is smaller than the scene
const UNDO = 20;
const KEY_STEP = 0.02; // of the picture's width that an arrow key moves the brush
const SPACING = 0.18; // of the brush's size between two stamps

export class Painter {
  /**
   * @param {HTMLCanvasElement} canvas over the picture; what it holds is the shadow
   * @param {HTMLElement} ring shows where the brush is, and how large
   * @param {() => void} painted called when a stroke is done
   */
  constructor(canvas, ring, painted) {
    this.canvas = canvas;
    this.ring = ring;
    this.painted = painted;
    this.pen = canvas.getContext("2d", { willReadFrequently: true });
    this.size = 0.08; // of the picture's width
    this.softness = 0.4; // of the brush that fades
    this.erases = false;
    this.at = [0.5, 0.75];
    this.sheet = null;
    this.listen();
  }

  /** Sheets hold one drawing each, with what undoes it; one may begin with what `coverageOf` gave. */
  static sheet(scene, coverage = null) {
    const shrink = Math.min(1, MOST_SIDE / Math.max(scene.width, scene.height));
    const size = [Math.round(scene.width * shrink), Math.round(scene.height * shrink)];
    if (coverage?.length !== size[0] * size[1]) return { size, pixels: null, past: [], blank: true };
    const pixels = new ImageData(...size);
    for (let i = 0; i < coverage.length; i++) pixels.data[4 * i + 3] = coverage[i];
    return { size, pixels, past: [], blank: false };
  }

  /** Work on a sheet. */
  open(sheet) {
    if (this.sheet === sheet) return;
    this.sheet = sheet;
    [this.canvas.width, this.canvas.height] = sheet.size;
    if (sheet.pixels) this.pen.putImageData(sheet.pixels, 0, 0);
  }

  undo() {
    if (!this.sheet?.past.length) return;
    const { pixels, blank } = this.sheet.past.pop();
    this.pen.putImageData(pixels, 0, 0);
    this.keep(blank);
  }

  clear() {
    if (this.sheet.blank) return;
    this.note();
    this.pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.keep(true);
  }

  note() {
    const pixels = this.pen.getImageData(0, 0, this.canvas.width, this.canvas.height);
    this.sheet.past.push({ pixels, blank: this.sheet.blank });
    if (this.sheet.past.length > UNDO) this.sheet.past.shift();
  }

  keep(blank) {
    this.sheet.pixels = this.pen.getImageData(0, 0, this.canvas.width, this.canvas.height);
    this.sheet.blank = blank ?? !this.sheet.pixels.data.some((value, i) => i % 4 === 3 && value > 8);
    this.painted();
  }

  /** A soft dot; the brush is a row of them. */
  stamp([x, y]) {
    const { width, height } = this.canvas;
    const radius = (this.size * width) / 2;
    const dot = this.pen.createRadialGradient(
      x * width, y * height, radius * (1 - this.softness), x * width, y * height, radius);
    dot.addColorStop(0, "rgb(0 0 0 / 1)");
    dot.addColorStop(1, "rgb(0 0 0 / 0)");
    this.pen.globalCompositeOperation = this.erases ? "destination-out" : "source-over";
    this.pen.fillStyle = dot;
    this.pen.beginPath();
    this.pen.arc(x * width, y * height, radius, 0, 2 * Math.PI);
    this.pen.fill();
  }

  stroke(from, to) {
    const aspect = this.canvas.height / this.canvas.width;
    const length = Math.hypot(to[0] - from[0], (to[1] - from[1]) * aspect);
    const stamps = Math.max(1, Math.ceil(length / (this.size * SPACING)));
    for (let i = 1; i <= stamps; i++) {
      const share = i / stamps;
      this.stamp([from[0] + (to[0] - from[0]) * share, from[1] + (to[1] - from[1]) * share]);
    }
  }

  showRing(visible = true) {
    const width = this.canvas.clientWidth * this.size;
    Object.assign(this.ring.style, {
      left: `${this.at[0] * 100}%`, top: `${this.at[1] * 100}%`, width: `${width}px`, height: `${width}px`,
    });
    this.ring.classList.toggle("erases", this.erases);
    this.ring.hidden = !visible || this.canvas.hidden;
  }

  listen() {
    const { canvas } = this;
    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      canvas.setPointerCapture(event.pointerId);
      this.note();
      this.drawing = true;
      this.at = place(event);
      this.stamp(this.at);
    });
    canvas.addEventListener("pointermove", (event) => {
      const passed = event.getCoalescedEvents?.() ?? [];
      for (const each of passed.length ? passed : [event]) {
        const next = place(each);
        if (this.drawing) this.stroke(this.at, next);
        this.at = next;
      }
      this.showRing();
    });
    const end = () => {
      if (!this.drawing) return;
      this.drawing = false;
      this.keep();
    };
    canvas.addEventListener("lostpointercapture", end);
    canvas.addEventListener("pointerleave", () => this.showRing(false));
    canvas.addEventListener("focus", () => this.showRing(canvas.matches(":focus-visible")));
    canvas.addEventListener("blur", () => this.showRing(false));
    canvas.addEventListener("keydown", (event) => this.keyed(event));
  }

  keyed(event) {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const step = steps[event.key];
    if (step) {
      const next = this.at.map((value, i) => clamped(value + step[i] * KEY_STEP, 0, 1));
      if (event.shiftKey) {
        this.note();
        this.stroke(this.at, next);
        this.keep();
      }
      this.at = next;
    } else if (event.key === " ") {
      this.note();
      this.stamp(this.at);
      this.keep();
    } else if (event.key === "z" && (event.ctrlKey || event.metaKey)) this.undo();
    else if (event.key === "e") this.canvas.dispatchEvent(new CustomEvent("eraser"));
    else return;
    event.preventDefault();
    this.showRing();
  }
}

/** How dark each pixel of a sheet is, 0 to 255; null of a blank one. */
export function coverageOf(sheet) {
  if (sheet.blank) return null;
  const { data } = sheet.pixels;
  const coverage = new Uint8Array(data.length / 4);
  for (let i = 0; i < coverage.length; i++) coverage[i] = data[4 * i + 3];
  return coverage;
}

/** A sheet as the service takes it: white shadow on black, as a data: URL. */
export function drawingOf(sheet) {
  const [width, height] = sheet.size;
  const canvas = new OffscreenCanvas(width, height);
  const pen = canvas.getContext("2d");
  const flat = new ImageData(width, height);
  for (let i = 0; i < flat.data.length; i += 4) {
    const value = sheet.pixels ? sheet.pixels.data[i + 3] : 0;
    flat.data[i] = flat.data[i + 1] = flat.data[i + 2] = value;
    flat.data[i + 3] = 255;
  }
  pen.putImageData(flat, 0, 0);
  return canvas.convertToBlob({ type: "image/png" }).then(asUrl);
}

function asUrl(blob) {
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    reader.onload = () => resolve(reader.result);
    reader.onerror = () => reject(reader.error);
    reader.readAsDataURL(blob);
  });
}
