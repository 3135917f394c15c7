// The service, as functions. Everything goes by fetch, so that one way serves with and without keys.

const KEY = "spotlight-key"; // of sessionStorage: gone with the tab

/** States that a job stays in, and the last events of its stream. */
export const ENDS = ["done", "failed", "cancelled"];

/** An answer of 400 or more, or none at all. */
export class Problem extends Error {
  constructor(status, told, retryAfter = null) {
    super(told.detail || told.title || `The service answered ${status}.`);
    this.status = status;
    this.errors = told.errors || [];
    this.retryAfter = retryAfter;
  }
}

let askForKey = async () => null;

/** Say how a person is asked for a key; `ask(refused)` resolves to one, or to null. */
export function onKeyNeeded(ask) {
  askForKey = ask;
}

/** One request; resolves to the Response if it went well, throws a Problem else. */
export async function call(path, { method = "GET", json, form, headers = {}, signal } = {}) {
  const key = sessionStorage.getItem(KEY);
  const sent = { ...headers, ...(key ? { Authorization: `Bearer ${key}` } : {}) };
  if (json !== undefined) sent["Content-Type"] = "application/json";
  const body = json !== undefined ? JSON.stringify(json) : form;
  let answer;
  try {
    answer = await fetch(path, { method, headers: sent, body, signal });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem(0, { detail: "The service cannot be reached. Is it still running?" });
  }
  if (answer.status === 401) {
    const given = await askForKey(Boolean(key));
    if (given) {
      sessionStorage.setItem(KEY, given);
      return call(path, { method, json, form, headers, signal });
    }
  }
  if (!answer.ok) {
    const told = await answer.json().catch(() => ({}));
    throw new Problem(answer.status, told, Number(answer.headers.get("Retry-After")) || null);
  }
  return answer;
}

const asJson = async (answer) => (await answer).json();
const asBlob = async (answer) => (await answer).blob();

export const capabilities = () => asJson(call("/v1/capabilities"));
export const ready = () => call("/v2/health/ready").then(() => true, () => false);
export const scene = (id) => asJson(call(`/v1/scenes/${id}`));
export const scenePicture = (id, show = "draft") => asBlob(call(`/v1/scenes/${id}/picture?show=${show}`));
export const relight = (json) => asJson(call("/v1/relight", { method: "POST", json }));
export const jobs = (limit = 50) => asJson(call(`/v1/jobs?limit=${limit}`)).then((told) => told.jobs);
export const job = (id) => asJson(call(`/v1/jobs/${id}`));
export const cancel = (id) => asJson(call(`/v1/jobs/${id}`, { method: "DELETE" }));
export const report = (id) => asJson(call(`/v1/jobs/${id}/report`));
/** The picture of a job; of a sweep the sheet, or the picture of one light. */
export const result = (id, accept = "image/png", light = null) =>
  asBlob(call(`/v1/jobs/${id}/result${light === null ? "" : `?light=${light}`}`, { headers: { Accept: accept } }));

/** Make a scene of form fields: `sample`, or `bundle`, or `photo`, `object` and where it stands. */
export function makeScene(fields, signal) {
  const form = new FormData();
  for (const [name, value] of Object.entries(fields)) {
    if (value !== null && value !== undefined && value !== "") form.append(name, value);
  }
  return asJson(call("/v1/scenes", { method: "POST", form, signal }));
}

/** Sketch lights; resolves to the picture and what there is to say about it. */
export async function sketch(id, lights, side, signal) {
  const json = { lights, side };
  const answer = await call(`/v1/scenes/${id}/shadow`, { method: "POST", json, signal });
  return { blob: await answer.blob(), notice: answer.headers.get("Spotlight-Notice") };
}

/** Events of a job, as `{kind, data}`, until its stream ends. */
export async function* events(id, signal) {
  const answer = await call(`/v1/jobs/${id}/events`, { signal });
  const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    text = (text + value).replaceAll("\r\n", "\n");
    let end;
    while ((end = text.indexOf("\n\n")) >= 0) {
      const event = parsed(text.slice(0, end));
      text = text.slice(end + 2);
      if (event) yield event;
    }
  }
}

function parsed(block) {
  let kind = "message";
  const data = [];
  for (const line of block.split("\n")) {
    if (line.startsWith("event:")) kind = line.slice(6).trim();
    else if (line.startsWith("data:")) data.push(line.slice(5).trimStart());
  }
  return data.length ? { kind, data: JSON.parse(data.join("\n")) } : null;
}
