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

/** Ask for an API key where the service wants one; once that is declined, only when told to by a button. */
export function bindKey() {
  const dialog = byId("key-dialog");
  const button = byId("enter-key");
  button.addEventListener("click", () => location.reload()); // which loses nothing, and asks anew
  let asking = null;
  let declined = false;
  onKeyNeeded((refused) => {
    if (declined) return null;
    asking ??= new Promise((resolve) => {
      dialog.returnValue = "";
      dialog.showModal();
      byId("key-refused").textContent = refused ? "That key is not valid here." : ""; // once it is seen
      dialog.addEventListener("close", () => {
        const key = dialog.returnValue ? byId("key").value.trim() : "";
        byId("key").value = "";
        asking = null;
        declined = !key;
        button.hidden = !declined;
        resolve(key || null);
      }, { once: true });
    });
    return asking;
  });
  byId("key-use").addEventListener("click", () => dialog.close("use"));
  byId("key").addEventListener("keydown", (event) => { if (event.key === "Enter") dialog.close("use"); });
}
