// The side: values in view and at the cursors, events, counters.

import { element, number } from "./scope.js";

const MAX_EVENTS = 300;
const REPEAT_S = 2; // the same event within this long counts as one that goes on

export class Values {
  constructor(table, shared, panels) {
    this.table = table;
    this.shared = shared;
    this.panels = panels;
    this.lines = [];
    this.make();
  }

  make() {
    const withCursors = Boolean(this.shared.cursors);
    const titles = withCursors ? ["", "A", "B", "B − A"] : ["", "least", "mean", "most"];
    const head = element("thead");
    const row = element("tr");
    for (const title of titles) row.append(element("th", "", title));
    head.append(row);
    const body = element("tbody");
    this.lines = [];
    this.time = withCursors ? this.line(body, "time [s]") : null;
    for (const panel of this.panels) {
      for (const trace of panel.traces) {
        this.lines.push({ panel, trace, cells: this.line(body, `${trace.label} [${panel.told.unit}]`) });
      }
    }
    this.table.replaceChildren(head, body);
    this.withCursors = withCursors;
  }

  line(body, title) {
    const row = element("tr");
    row.append(element("th", "", title));
    const cells = [0, 1, 2].map(() => element("td", "", "–"));
    row.append(...cells);
    body.append(row);
    return cells;
  }

  update() {
    if (this.withCursors !== Boolean(this.shared.cursors)) this.make();
    if (this.time) {
      const [a, b] = this.shared.cursors;
      fill(this.time, [a, b, b - a], this.shared.view[1] - this.shared.view[0]);
    }
    for (const { panel, trace, cells } of this.lines) {
      const stream = panel.stream(trace);
      const scale = panel.told.scale;
      if (!stream) fill(cells, [NaN, NaN, NaN], 1);
      else if (this.withCursors) {
        const [a, b] = this.shared.cursors.map((t) => stream.value(trace.field, t) * scale);
        fill(cells, [a, b, b - a], panel.span);
      } else {
        const found = statistics(stream, trace.field, this.shared.view);
        fill(cells, found.map((value) => value * scale), panel.span);
      }
    }
  }
}

function fill(cells, values, span) {
  cells.forEach((cell, place) => {
    cell.textContent = number(values[place], span);
  });
}

function statistics(stream, field, [from, to]) {
  const column = stream.column(field);
  const end = stream.at(to);
  let low = Infinity;
  let high = -Infinity;
  let sum = 0;
  let count = 0;
  for (let row = stream.at(from); row < end; row += 1) {
    const value = column[row];
    if (value !== value) continue;
    if (value < low) low = value;
    if (value > high) high = value;
    sum += value;
    count += 1;
  }
  return count ? [low, sum / count, high] : [NaN, NaN, NaN];
}

export class Events {
  constructor(list, shared) {
    this.list = list;
    this.shared = shared;
    this.seen = new Map(); // by stream and lane: rows looked at, the last code
    this.known = new Map(); // by text: the line, when last, how often
  }

  clear() {
    this.seen.clear();
  }

  // Look at the rows that came since the last call for changes of the lanes.
  update(lanes) {
    const found = [];
    for (const lane of lanes.told) {
      const stream = this.shared.store.find(lane.topic, this.shared.axis);
      if (!stream || !stream.rows) continue;
      const key = `${lane.topic} ${lane.field} ${this.shared.axis}`;
      const before = this.seen.get(key) || { t: -Infinity, code: null };
      const column = stream.column(lane.field);
      for (let row = stream.at(before.t + 1e-9); row < stream.rows; row += 1) {
        if (column[row] === before.code) continue;
        before.code = column[row];
        const code = lanes.code(lane, before.code);
        // A gate that lets pass and a tick that had nothing new are no events.
        if (lane.title !== "gate" || code.level === "warn" || code.level === "bad") {
          found.push([stream.columns[0][row], `${lane.title}: ${code.name}`, code.level]);
        }
      }
      before.t = stream.newest;
      this.seen.set(key, before);
    }
    found.sort((one, other) => one[0] - other[0]);
    for (const each of found) this.add(...each);
  }

  add(t, text, level) {
    const known = this.known.get(text);
    if (known && t - known.t < REPEAT_S) {
      known.t = t;
      known.count += 1;
      known.what.textContent = `${text} ×${known.count}`;
      return;
    }
    const item = element("li", level);
    const what = element("span", "", text);
    item.append(element("time", "", Number.isFinite(t) ? t.toFixed(3) : ""), what);
    this.list.prepend(item);
    this.known.set(text, { t, what, count: 1 });
    while (this.list.childElementCount > MAX_EVENTS) this.list.lastElementChild.remove();
  }
}

// Names that stand for trouble where they are not nought.
const TROUBLE = /lost|bad|overrun|skipped|stale|full|refused|denied|unpaired|not_increasing|limited|frozen|late|dropped/;

export class Counters {
  constructor(root) {
    this.root = root;
    this.cells = new Map();
  }

  update(groups) {
    for (const [title, counts] of Object.entries(groups)) {
      for (const [name, value] of Object.entries(counts)) this.set(title, name, value);
    }
  }

  set(title, name, value) {
    const key = `${title}/${name}`;
    if (!this.cells.has(key)) this.cells.set(key, this.cell(title, name));
    const cell = this.cells.get(key);
    const text = typeof value === "number" ? value.toLocaleString("en").replaceAll(",", "\u2009") : String(value);
    if (cell.textContent !== text) cell.textContent = text;
    cell.classList.toggle("changed", TROUBLE.test(name) && value > 0);
  }

  cell(title, name) {
    const id = `group ${title}`;
    if (!this.cells.has(id)) {
      const block = element("div", "counts");
      const table = element("table");
      block.append(element("h3", "", title), table);
      this.root.append(block);
      this.cells.set(id, table);
    }
    const row = element("tr");
    row.append(element("td", "", name.replaceAll("_", " ")));
    const cell = element("td");
    row.append(cell);
    this.cells.get(id).append(row);
    return cell;
  }
}
