// What outlives a reload: small facts in localStorage, files and thumbnails in IndexedDB.

const NAME = "spotlight";
const TABLE = "kept";

function opened() {
  return new Promise((resolve, reject) => {
    const request = indexedDB.open(NAME, 1);
    request.onupgradeneeded = () => request.result.createObjectStore(TABLE);
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
}

async function table(mode, act) {
  // A browser that keeps nothing (private windows) is no reason to fail.
  try {
    const database = await opened();
    return await new Promise((resolve, reject) => {
      const request = act(database.transaction(TABLE, mode).objectStore(TABLE));
      request.onsuccess = () => resolve(request.result);
      request.onerror = () => reject(request.error);
    }).finally(() => database.close());
  } catch {
    return undefined;
  }
}

export const get = (key) => table("readonly", (kept) => kept.get(key));
export const put = (key, value) => table("readwrite", (kept) => kept.put(value, key));

/** Forget thumbnails of jobs that the service no longer knows. */
export async function keepOnly(prefix, names) {
  const keys = (await table("readonly", (kept) => kept.getAllKeys())) || [];
  const stale = keys.filter((key) => key.startsWith(prefix) && !names.has(key.slice(prefix.length)));
  await Promise.all(stale.map((key) => table("readwrite", (kept) => kept.delete(key))));
}

export function remember(name, value) {
  try {
    localStorage.setItem(`spotlight-${name}`, JSON.stringify(value));
  } catch {
    // Full or forbidden: it is a convenience only.
  }
}

export function recall(name, otherwise) {
  try {
    return JSON.parse(localStorage.getItem(`spotlight-${name}`)) ?? otherwise;
  } catch {
    return otherwise;
  }
}
