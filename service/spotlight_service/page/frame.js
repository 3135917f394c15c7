// What surrounds the desk: drops, the colour scheme, the question for a key.

import { onKeyNeeded } from "./api.js";
import { byId, onRadio, setRadio } from "./ui.js";

/** Take files that are dropped anywhere. */
export function bindDrops(take) {
  let depth = 0;
  const veil = byId("veil");
  const files = (event) => event.dataTransfer?.types.includes("Files");
  window.addEventListener("dragenter", (event) => { if (files(event)) { depth++; veil.hidden = false; } });
  window.addEventListener("dragleave", (event) => { if (files(event) && --depth <= 0) veil.hidden = true; });
  window.addEventListener("dragover", (event) => { if (files(event)) event.preventDefault(); });
  window.addEventListener("drop", (event) => {
    if (!files(event)) return;
    event.preventDefault();
    depth = 0;
    veil.hidden = true;
    take([...event.dataTransfer.files]);
  });
}

/** Let the colour scheme be chosen; theme.js shows the choice before the first paint. */
export function bindTheme() {
  setRadio("theme", document.documentElement.dataset.theme || "auto");
  onRadio("theme", (theme) => {
    if (theme === "auto") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = theme;
    localStorage.setItem("spotlight-theme", theme);
  });
}

/** Ask for an API key where the service wants one. */
export function bindKey() {
  const dialog = byId("key-dialog");
  let asking = null;
  onKeyNeeded(() => {
    asking ??= new Promise((resolve) => {
      dialog.showModal();
      dialog.addEventListener("close", () => {
        asking = null;
        resolve(dialog.returnValue ? byId("key").value.trim() : null);
        byId("key").value = "";
      }, { once: true });
    });
    return asking;
  });
  byId("key-use").addEventListener("click", () => dialog.close("use"));
  byId("key").addEventListener("keydown", (event) => { if (event.key === "Enter") dialog.close("use"); });
}
