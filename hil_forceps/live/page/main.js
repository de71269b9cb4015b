// The page: what the run tells goes into the store, and from there, some twenty times a second, onto the screen.

import { savePicture, saveTable, table } from "./export.js";
import { Lanes } from "./lanes.js";
import { Link } from "./link.js";
import { forgetColours, number, Panel } from "./scope.js";
import { Counters, Events, Values } from "./side.js";
import { Store } from "./store.js";

const FRAME_MS = 50;
const SIDE_MS = 250;
const LEVELS = { running: "ok", operational: "ok", open: "ok", enabling: "note", armed: "note", stopping: "warn",
  frozen: "warn", failing: "bad", latched: "bad", fault: "bad", stopped: "bad" };
const AS_MEANT = new Set(["", "completed", "stop_requested"]);

const at = (id) => document.getElementById(id);
const page = {
  store: new Store([]),
  axis: 0,
  view: [0, 10],
  cursors: null,
  panels: [],
  lanes: null,
  windowS: 10,
  isPaused: false,
  isLocked: false,
  hovered: null,
  isDirty: true,
  frames: 0,
  drawMs: 0,
  head: { enveloped: 0, lost: 0 },
  lostInChannel: 0,
  status: null,
  redraw: () => { page.isDirty = true; },
  hover: (t) => { page.hovered = t; page.redraw(); },
  click: (t) => moveCursor(t),
  zoom: (from, to) => { pause(true); page.view = [from, to]; page.redraw(); },
  zoomOut: () => pause(false),
};
window.live = page; // for whoever wants to look closer, and for the tests

const counters = new Counters(at("counters"));
const events = new Events(at("events"), page);
let values = null;

const link = new Link({ hello, status, frame, end, state });

function hello(told) {
  document.title = `${told.title} – live`;
  at("title").textContent = told.title;
  at("title").title = told.title;
  at("control").hidden = !told.control;
  at("axis").hidden = told.axes.length < 2;
  at("axis").replaceChildren(...told.axes.map((name, place) => new Option(name || "axis", String(place))));
  page.axis = Math.min(page.axis, told.axes.length - 1);
  at("axis").value = String(page.axis);
  page.store = new Store(told.streams);
  if (!page.panels.length) {
    page.panels = told.panels.map((panel) => new Panel(panel, page));
    page.lanes = new Lanes(told.lanes, page);
    at("panels").replaceChildren(...page.panels.map((panel) => panel.root), page.lanes.root);
    values = new Values(at("values"), page, page.panels);
  }
  layout();
}

function frame(buffer) {
  page.head = page.store.take(buffer);
  page.redraw();
}

function status(told) {
  page.lostInChannel = told.lost;
  if (!told.status) return;
  page.status = told.status;
  showStatus();
}

function showStatus() {
  const axis = page.status && page.status.axes[page.axis];
  if (!axis) return;
  pill("stage", axis.stage, axis.stage);
  pill("drive", `drive ${axis.drive}`, axis.drive);
  pill("gate", axis.gate ? `gate ${axis.gate}` : "", axis.gate);
  at("gate").hidden = !axis.gate;
  const words = [axis.message, axis.fault && `the drive's fault: ${axis.fault}`, axis.refusal, axis.trip && `gate: ${axis.trip}`];
  if (axis.message || axis.fault || axis.refusal || axis.trip) {
    banner(words.filter(Boolean).join(" · "), AS_MEANT.has(axis.reason) && !axis.fault && !axis.refusal ? "note" : "bad");
  } else if (at("link").classList.contains("ok")) banner("");
  counters.update({ ...page.status.counters, ...axis.counters });
  const isStopped = axis.stage === "stopped";
  at("clear").disabled = !isStopped;
  at("stop").disabled = isStopped || axis.stage === "ended";
}

function end() {
  if (page.status) showStatus();
  at("stop").disabled = true;
  at("clear").disabled = true;
}

function state(level, words) {
  at("link").className = `dot ${level}`;
  at("link").title = words;
  if (level === "ok") banner("");
  else if (level === "off") {
    if (at("banner").hidden) banner(words, "note");
    pill("stage", "ended", "ended");
  } else banner(words, level === "warn" ? "warn" : "bad");
  if (level === "warn") at("stop").disabled = true;
}

function banner(words, level = "bad") {
  at("banner").textContent = words;
  at("banner").className = level;
  at("banner").hidden = !words;
}

function pill(id, words, key) {
  at(id).textContent = words;
  at(id).className = `pill ${LEVELS[key] || "off"}`;
}

// -- layout ----------------------------------------------------------------------------------------------------------

function layout() {
  const root = at("panels");
  const isWide = root.clientWidth > 860;
  const isStacked = innerWidth <= 900;
  root.style.setProperty("--columns", isWide ? 2 : 1);
  const rows = Math.ceil(page.panels.length / (isWide ? 2 : 1));
  page.panels.forEach((panel, place) => {
    const isAlone = isWide && place % 2 === 0 && place === page.panels.length - 1;
    panel.root.classList.toggle("alone", isAlone);
  });
  const lanes = page.lanes ? 34 + 20 * page.lanes.told.length : 0;
  const room = isStacked ? 180 * rows : root.clientHeight - lanes - 10 * rows;
  const heads = page.panels.map((panel) => panel.root.firstElementChild.offsetHeight);
  const height = Math.max(isWide ? 110 : 116, Math.floor(room / Math.max(rows, 1)) - Math.max(...heads, 20) - 8);
  for (const panel of page.panels) panel.size(panel.root.clientWidth - 14, height);
  if (page.lanes) page.lanes.size(page.lanes.root.clientWidth - 14);
  page.redraw();
}

new ResizeObserver(() => layout()).observe(at("panels"));

// -- drawing ---------------------------------------------------------------------------------------------------------

let drawnMs = 0;
let sideMs = 0;

function draw(nowMs) {
  requestAnimationFrame(draw);
  // A wide window moves by less than a pixel a frame: then fewer frames do.
  const width = Math.max(at("panels").clientWidth, 300);
  const frameMs = page.isPaused ? FRAME_MS : Math.max(FRAME_MS, Math.min(500, (page.windowS * 1000) / width));
  if (!page.isDirty || nowMs - drawnMs < frameMs) return;
  drawnMs = nowMs;
  page.isDirty = false;
  const newest = page.store.newest;
  if (!Number.isFinite(newest)) return;
  if (!page.isPaused) page.view = [newest - page.windowS, newest];
  const began = performance.now();
  for (const panel of page.panels) panel.update(page.isLocked);
  page.lanes.update();
  page.drawMs += 0.1 * (performance.now() - began - page.drawMs);
  page.frames += 1;
  if (nowMs - sideMs < SIDE_MS && page.hovered === null) return;
  sideMs = nowMs;
  const t = page.hovered === null ? page.view[1] : page.hovered;
  for (const panel of page.panels) panel.values(t);
  page.lanes.values(t);
  at("clock").textContent = `${newest.toFixed(2)} s`;
  values.update();
  events.update(page.lanes);
  showPage();
}
requestAnimationFrame(draw);

function showPage() {
  const rows = page.store.streams.reduce((sum, stream) => sum + stream.rows, 0);
  const facts = [
    ["rows held", String(rows)],
    ["lost before the page", String(page.lostInChannel + page.head.lost)],
    ["as envelope only", String(page.head.enveloped)],
    ["in view", `${number(page.view[1] - page.view[0], 100)} s`],
    ["time to draw", `${page.drawMs.toFixed(1)} ms`],
  ];
  at("page").replaceChildren(
    ...facts.flatMap(([name, value]) => {
      const term = document.createElement("dt");
      const data = document.createElement("dd");
      term.textContent = name;
      data.textContent = value;
      return [term, data];
    }),
  );
}

// -- tools -----------------------------------------------------------------------------------------------------------

function pressed(id, isOn) {
  at(id).setAttribute("aria-pressed", String(isOn));
}

function pause(isOn) {
  page.isPaused = isOn;
  pressed("pause", isOn);
  at("pause").textContent = isOn ? "Go on" : "Pause";
  page.redraw();
}

function toggleCursors() {
  const [from, to] = page.view;
  page.cursors = page.cursors ? null : [from + (to - from) / 3, from + (2 * (to - from)) / 3];
  if (page.cursors) pause(true);
  pressed("cursors", Boolean(page.cursors));
  sideMs = 0;
  page.redraw();
}

function moveCursor(t) {
  if (!page.cursors) return;
  const [a, b] = page.cursors;
  page.cursors = Math.abs(t - a) <= Math.abs(t - b) ? [t, b] : [a, t];
  sideMs = 0;
  page.redraw();
}

function toggleLock() {
  page.isLocked = !page.isLocked;
  pressed("lock", page.isLocked);
  page.redraw();
}

function span() {
  return page.cursors ? [Math.min(...page.cursors), Math.max(...page.cursors)] : page.view;
}

function fileName() {
  const title = at("title").textContent.replace(/[^\w.-]+/g, "_").slice(0, 60) || "live";
  return `${title}_${span()[0].toFixed(3)}s`;
}

function setTheme(isDark) {
  document.documentElement.classList.toggle("dark", isDark);
  forgetColours();
  for (const panel of page.panels) if (panel.chart) panel.chart.redraw(false, true);
  page.redraw();
}

const systemDark = matchMedia("(prefers-color-scheme: dark)");
const chosen = localStorage.getItem("theme");
setTheme(chosen ? chosen === "dark" : systemDark.matches);
systemDark.addEventListener("change", (event) => { if (!localStorage.getItem("theme")) setTheme(event.matches); });

at("pause").addEventListener("click", () => pause(!page.isPaused));
at("cursors").addEventListener("click", toggleCursors);
at("lock").addEventListener("click", toggleLock);
at("window").addEventListener("change", (event) => { page.windowS = Number(event.target.value); pause(false); });
at("axis").addEventListener("change", (event) => {
  page.axis = Number(event.target.value);
  for (const panel of page.panels) panel.range = [0, 0];
  at("counters").replaceChildren();
  counters.cells.clear();
  showStatus();
  page.redraw();
});
at("csv").addEventListener("click", () => saveTable(table(page.store, page.axis, page.panels, span()), fileName()));
at("png").addEventListener("click", () => savePicture(page.panels, at("title").textContent, fileName()));
at("theme").addEventListener("click", () => {
  const isDark = !document.documentElement.classList.contains("dark");
  localStorage.setItem("theme", isDark ? "dark" : "light");
  setTheme(isDark);
});
at("stop").addEventListener("click", () => {
  if (!link.ask("stop")) banner("The stop could not be sent: there is no connection. Switch off the supply.", "bad");
  else events.add(page.store.newest, "emergency stop asked for", "bad");
});
at("clear").addEventListener("click", () => {
  if (link.ask("clear")) events.add(page.store.newest, "clear asked for", "note");
});
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || /SELECT|INPUT|BUTTON/.test(event.target.tagName)) return;
  const keys = { " ": () => pause(!page.isPaused), c: toggleCursors, l: toggleLock };
  const act = keys[event.key];
  if (!act) return;
  event.preventDefault();
  act();
});
