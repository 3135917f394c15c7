// Small helpers for the page's elements.

export const byId = (id) => document.getElementById(id);

/** What an <img> shows while it has nothing to show. */
export const NOTHING = "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg'/%3E";

/** An element with properties and children. */
export function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

const LONG_MS = 9000;

/** Say something that went wrong, or that is worth knowing. */
export function toast(text, kind = "wrong") {
  const close = element("button", { type: "button", className: "close", ariaLabel: "Dismiss" }, "×");
  const shown = element("div", { className: `toast ${kind}` }, element("p", {}, text), close);
  close.addEventListener("click", () => shown.remove());
  byId("toasts").append(shown);
  while (byId("toasts").children.length > 3) byId("toasts").firstChild.remove();
  setTimeout(() => shown.remove(), LONG_MS);
}

/** Tell an error as the service put it. */
export function tell(error) {
  if (error.name === "AbortError") return;
  if (error.status === undefined) console.error(error);
  const wait = error.status === 429 && error.retryAfter ? ` Try again in ${error.retryAfter} s.` : "";
  toast(`${error.message}${wait}`);
}

/** The value of a group of radio buttons; setting it does not raise `change`. */
export const radio = (name) => document.querySelector(`input[name="${name}"]:checked`)?.value;
export function setRadio(name, value) {
  const found = document.querySelector(`input[name="${name}"][value="${value}"]`);
  if (found) found.checked = true;
}
export function onRadio(name, act) {
  document.querySelectorAll(`input[name="${name}"]`).forEach((input) =>
    input.addEventListener("change", () => act(input.value)));
}

let rows = 0;

/**
 * A slider with a number beside it that can be typed.
 *
 * @returns {{row, get: () => number, set: (value: number) => void}} `changed(value, settled)` is
 *   called when a person moves it; `settled` once they let go.
 */
export function slider({ label, hint, min, max, step, value, unit = "", changed = () => {} }) {
  const id = `row-${++rows}`;
  const range = element("input", { type: "range", id, min, max, step, value });
  const number = element("input", {
    type: "number", min, max, step, value, ariaLabel: unit ? `${label}, ${unit}` : `${label}, number`,
  });
  const name = element("label", { htmlFor: id }, label);
  const box = element("span", { className: "number" }, number, element("span", { className: "unit" }, unit));
  const row = element("div", { className: "row" }, name, range, box);
  if (hint) {
    const told = element("p", { className: "hint", id: `${id}-hint` }, hint);
    range.setAttribute("aria-describedby", told.id);
    row.append(told);
  }
  const fill = () => range.style.setProperty("--share", (range.value - min) / (max - min));
  const show = (next) => {
    range.value = next;
    number.value = Number(Number(next).toFixed(step < 0.1 ? 2 : step < 1 ? 1 : 0));
    fill();
  };
  range.addEventListener("input", () => { show(range.value); changed(Number(range.value), false); });
  range.addEventListener("change", () => changed(Number(range.value), true));
  number.addEventListener("change", () => {
    const typed = Number.isFinite(number.valueAsNumber) ? number.valueAsNumber : Number(range.value);
    show(Math.min(max, Math.max(min, typed)));
    changed(Number(range.value), true);
  });
  fill();
  return { row, get: () => Number(range.value), set: show };
}

/** Offer a blob as a file. */
export function save(blob, name) {
  const link = element("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

/** Show a blob in an <img>, freeing the one before. */
export async function display(image, blob) {
  const url = URL.createObjectURL(blob);
  const old = image.dataset.url;
  image.dataset.url = url;
  image.src = url;
  await image.decode().catch(() => {});
  if (old) URL.revokeObjectURL(old);
}

export function seconds(value) {
  if (value === null || value === undefined) return "";
  if (value < 10) return `${value.toFixed(value < 1.95 ? 1 : 0)} s`;
  if (value < 100) return `${Math.round(value)} s`;
  return `${Math.floor(value / 60)} min ${String(Math.round(value % 60)).padStart(2, "0")} s`;
}
