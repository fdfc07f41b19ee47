"use strict";
/* The page: what /api/v1 tells, kept up to date by its event stream. Texts of scenes, jobs and
 * workers reach the document by textContent only. */

const api = "/api/v1";
const pictureMs = 1000; /* between two looks at a picture that is being rendered */
const jobs = new Map(); /* id -> item of the list */
let selected = location.hash.slice(1) || null;
let next = null, lastEvent = 0, stream = null, pictureAsked = 0;
let pictureRev = null, pictureBusy = false, reportBusy = false, reportDue = false;

const $ = (id) => document.getElementById(id);

function text(tag, content, className) {
  const e = document.createElement(tag);
  e.textContent = content;
  if (className) e.className = className;
  return e;
}

async function call(path, options) {
  const answer = await fetch(api + path, options);
  if (answer.status === 401) {
    $("login").hidden = false;
    throw new Error("token");
  }
  if (!answer.ok) {
    const problem = await answer.json().catch(() => ({}));
    throw new Error(problem.detail || answer.statusText);
  }
  return answer;
}

const read = async (path) => (await call(path)).json();
const change = (path, body) => call(path, { method: "PATCH", body: JSON.stringify(body) });
const percent = (v) => (v == null ? "-" : Math.floor(100 * v) + " %");
const figures = (v) => (v < 10 ? v.toPrecision(2) : Math.round(v));
const left = (v) => (v ? figures(v[0]) + "-" + figures(v[1]) + " s" : "-");
const count = (n, word) => n + " " + word + (n === 1 ? "" : "s");
const rays = (v) => (v >= 1e9 ? (v / 1e9).toFixed(1) + " Gray/s"
  : v >= 1e6 ? (v / 1e6).toFixed(1) + " Mray/s" : Math.round(v / 1e3) + " kray/s");

/* --- Jobs ---------------------------------------------------------------- */

function jobRow(job) {
  const row = document.createElement("tr");
  const link = text("a", job.id);
  link.href = "#" + job.id;
  const first = document.createElement("td");
  first.append(link);
  row.append(first, text("td", job.name), text("td", job.state, "state " + job.state),
    text("td", percent(job.done), "number"), text("td", left(job.left_s), "number"),
    text("td", job.workers || "-", "number"), text("td", job.note || ""));
  row.setAttribute("aria-current", String(job.id === selected));
  return row;
}

/* Newest first, as far as the filter lets through. */
function listed() {
  const wanted = $("filter").value.toLowerCase();
  return [...jobs.values()]
    .filter((j) => !wanted || (j.id + " " + j.name + " " + j.state).toLowerCase().includes(wanted))
    .sort((a, b) => Number(b.id.slice(1)) - Number(a.id.slice(1)));
}

function showJobs() {
  const list = listed();
  $("jobs").replaceChildren(...list.map(jobRow));
  $("no-jobs").hidden = jobs.size > 0;
  $("some-jobs").hidden = jobs.size === 0;
  $("no-match").hidden = list.length > 0;
  $("more").hidden = !next;
}

async function loadJobs(cursor) {
  const page = await read("/jobs?limit=100" + (cursor ? "&cursor=" + cursor : ""));
  if (!cursor) jobs.clear();
  for (const job of page.items) jobs.set(job.id, job);
  next = page.next;
  if (!selected && page.items.length) selected = page.items[0].id;
  showJobs();
}

/* --- The chosen job ------------------------------------------------------- */

function put(list, name, value) {
  if (value == null) return;
  list.append(text("dt", name), text("dd", String(value)));
}

function showReport(r) {
  const list = document.createElement("dl");
  list.id = "report";
  put(list, "size", r.width + " x " + r.height);
  put(list, "samples a pixel", r.spp_mean);
  put(list, "relMSE", r.error.relmse == null ? null : r.error.relmse.toPrecision(3) + " (95 %: "
    + r.error.relmse_low.toPrecision(3) + " to " + r.error.relmse_high.toPrecision(3) + ")"
    + (r.error.heavy_tail ? "; heavy tail: not to be trusted" : ""));
  put(list, "worst cell", r.error.worst_cell == null ? null : "at " + r.error.worst_cell.x + ","
    + r.error.worst_cell.y + ": " + r.error.worst_cell.relmse.toPrecision(3));
  put(list, "stopped by", r.stopped_by == null || r.stopped_by === "spp" ? null : r.stopped_by);
  put(list, "seconds", Object.entries(r.seconds).filter(([, v]) => v != null)
    .map(([k, v]) => k.replace("_", " ") + " " + v.toFixed(2)).join(", "));
  put(list, "core seconds", r.core_seconds.toFixed(1));
  put(list, "rays", r.rays.toLocaleString("en"));
  put(list, "units", Object.entries(r.units).map(([k, v]) => k + " " + v).join(", "));
  put(list, "non-finite samples", r.nonfinite_samples || null);
  put(list, "sha256", r.image_sha256);
  $("report").replaceWith(list);
  $("log").replaceChildren(...r.events.map((e) => text("li", e.t.toFixed(1) + " s  " + e.text)));
}

function showJob(r) {
  $("job").hidden = false;
  $("job-title").textContent = r.id + " " + r.name;
  $("job-line").textContent = r.state + (r.state === "done" ? "" : ", " + percent(r.done) + " done")
    + (r.left_s ? ", " + left(r.left_s) + " left" : "") + (r.note ? ": " + r.note : "");
  $("job-progress").value = r.done || 0;
  $("job-progress").hidden = r.state === "done";
  const can = { paused: ["queued", "rendering"], queued: ["paused", "failed", "cancelled"],
    cancelled: ["queued", "rendering", "paused"] };
  for (const button of $("job-actions").querySelectorAll("button")) {
    button.hidden = !can[button.dataset.state].includes(r.state);
    if (button.dataset.state === "queued")
      button.textContent = r.state === "paused" ? "Resume" : "Retry";
  }
  for (const kind of ["exr", "png"]) {
    $(kind).hidden = r.state !== "done";
    $(kind).href = api + "/jobs/" + r.id + "/picture." + kind;
    $(kind).download = (r.name || r.id) + "." + kind;
  }
  $("shell-command").textContent = "TILERY_MASTER=" + location.origin + " tilery "
    + (r.state === "done" ? "get " + r.id + " -o " + r.id + ".exr" : (can.cancelled.includes(r.state) ? "watch " : "status ") + r.id);
  showReport(r);
}

async function loadPicture(r) {
  const key = r.id + " " + (r.state === "done" ? r.image_sha256 : r.done);
  if (pictureBusy || key === pictureRev || document.hidden) return;
  if (r.state !== "done" && Date.now() - pictureAsked < pictureMs) return;
  pictureBusy = true;
  pictureAsked = Date.now();
  try {
    const answer = await call("/jobs/" + r.id + "/picture.png?partial=1");
    const url = URL.createObjectURL(await answer.blob());
    if (r.id === selected) {
      const crop = r.spec.crop || [0, 0];
      viewer.show(url, "picture of " + r.id + ", " + percent(r.done) + " done", crop);
      pictureRev = key;
    } else {
      URL.revokeObjectURL(url);
    }
  } finally {
    pictureBusy = false;
  }
}

async function loadJob() {
  if (!selected) return;
  reportDue = reportBusy;
  if (reportBusy) return;
  reportBusy = true;
  try {
    const r = await read("/jobs/" + encodeURIComponent(selected));
    if (r.id === selected) {
      showJob(r);
      await loadPicture(r);
    }
  } catch (e) {
    $("problem").textContent = e.message === "token" ? "" : e.message;
  } finally {
    reportBusy = false;
    if (reportDue) loadJob();
  }
}

function select(id) {
  selected = id;
  pictureRev = null;
  pictureAsked = 0;
  viewer.clear();
  $("problem").textContent = "";
  showJobs();
  loadJob();
}

/* --- Workers and farm ------------------------------------------------------ */

/* Who left in order is not lost. */
function workerState(w) {
  const state = w.state === "lost" && w.note === "left" ? "left" : w.state;
  return text("td", state.replace("-", " "), "state " + state);
}

function workerRow(w) {
  const row = document.createElement("tr");
  const last = document.createElement("td");
  if (["idle", "busy", "loading"].includes(w.state)) {
    const button = text("button", "Drain");
    button.addEventListener("click", () => change("/workers/" + w.id, { state: "draining" })
      .catch((e) => { $("problem").textContent = e.message; }));
    last.append(button);
  }
  row.append(text("td", w.id), text("td", w.name), workerState(w),
    text("td", w.job || "-"),
    text("td", w.threads, "number"), text("td", w.speed_rays_s > 0 ? rays(w.speed_rays_s) : "-", "number"),
    text("td", w.units, "number"), text("td", w.lost, "number"),
    text("td", w.note || (w.tags.length ? "tags " + w.tags.join(", ") : "")), last);
  return row;
}

async function loadFarm() {
  const [workers, farm] = await Promise.all([read("/workers"), read("/farm")]);
  $("workers").replaceChildren(...workers.items.map(workerRow));
  $("no-workers").hidden = farm.workers > 0;
  $("worker-command").textContent = "tilery-worker --master " + farm.listen;
  $("commands").textContent = "export TILERY_MASTER=" + location.origin + "\n"
    + "tilery submit scene.json\n" + "tilery watch j1";
  $("workers-table").hidden = workers.items.length === 0;
  $("farm").textContent = farm.jobs.rendering + " rendering, " + farm.jobs.queued + " queued, "
    + count(farm.workers, "worker") + ", " + count(farm.threads, "thread")
    + (farm.jobs.rendering > 0 && farm.rays_s > 0 ? ", " + rays(farm.rays_s) : "");
}

/* --- Events ---------------------------------------------------------------- */

let farmDue = false;
function farmSoon() {
  if (farmDue) return;
  farmDue = true;
  setTimeout(() => { farmDue = false; loadFarm().catch(() => {}); }, 300);
}

function online(is) {
  document.body.classList.toggle("offline", !is);
  $("offline").hidden = is;
  if (!is) $("offline").textContent = "No answer since " + new Date(lastEvent).toLocaleTimeString()
    + "; trying again. What is shown is as of then.";
}

function onJob(data) {
  const job = Object.assign(jobs.get(data.id) || { name: "", workers: 0 }, data);
  if (!jobs.has(data.id)) {
    jobs.set(data.id, job);
    loadJobs().catch(() => {});
  }
  showJobs();
  if (!selected) selected = data.id;
  if (data.id === selected) loadJob();
  farmSoon();
}

function listen() {
  if (stream) stream.close();
  stream = new EventSource(api + "/events");
  const on = (type, f) => stream.addEventListener(type, (e) => {
    lastEvent = Date.now();
    f(JSON.parse(e.data));
  });
  on("hello", () => { online(true); loadAll(); });
  on("reset", loadAll);
  on("job", onJob);
  on("gone", (d) => { for (const id of d.jobs) jobs.delete(id); showJobs(); });
  on("workers", farmSoon);
  on("log", (d) => { if (d.job === selected) loadJob(); });
  stream.onerror = () => online(false);
}

function loadAll() {
  return Promise.all([loadJobs(), loadFarm()]).then(loadJob).catch(() => {});
}

async function start() {
  lastEvent = Date.now();
  try {
    await read("/farm");
    listen();
  } catch (e) {
    $("farm").textContent = e.message === "token" ? "" : "no answer: " + e.message;
  }
}

$("login").addEventListener("submit", async (event) => {
  event.preventDefault();
  const answer = await fetch(api + "/session",
    { method: "POST", body: JSON.stringify({ token: $("token").value }) });
  $("token").value = "";
  $("login").hidden = answer.ok;
  $("login-note").textContent = answer.ok ? "" : "that is not this farm's token";
  if (answer.ok) start();
});
$("job-actions").addEventListener("click", async (event) => {
  const state = event.target.dataset.state;
  if (!state || (state === "cancelled" && !confirm("Cancel " + selected + "?"))) return;
  event.target.disabled = true;
  try {
    await change("/jobs/" + selected, { state });
    $("problem").textContent = "";
  } catch (e) {
    $("problem").textContent = e.message;
  }
  event.target.disabled = false;
  loadJob();
});
/* Keys do nothing while something is typed, nor with a modifier. */
function step(by) {
  const list = listed(), at = list.findIndex((j) => j.id === selected);
  const to = list[Math.min(list.length - 1, Math.max(0, at + by))];
  if (to) location.hash = to.id;
}
const keys = { j: () => step(1), k: () => step(-1), "/": () => $("filter").focus(), f: () => viewer.fit(),
  1: () => viewer.zoomTo(1), "+": () => viewer.zoomBy(1.5), "-": () => viewer.zoomBy(1 / 1.5),
  "?": () => $("help").showModal() };
document.addEventListener("keydown", (event) => {
  const typing = event.target.matches("input, textarea, select") && event.target.type !== "checkbox";
  if (typing && event.key === "Escape") {
    if (event.target.id === "filter") { // a search field empties itself and does not say so
      event.target.value = "";
      showJobs();
    }
    event.target.blur();
  }
  if (typing || event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
  if (!Object.hasOwn(keys, event.key) || (!$("keys-on").checked && event.key !== "?")) return;
  event.preventDefault();
  keys[event.key]();
});
$("help-button").addEventListener("click", () => $("help").showModal());
$("filter").addEventListener("input", showJobs);
$("more").addEventListener("click", () => loadJobs(next).catch(() => {}));
window.addEventListener("hashchange", () => select(location.hash.slice(1)));
setInterval(() => { if (selected && jobs.get(selected)?.state === "rendering") loadJob(); }, 2000);
start();
