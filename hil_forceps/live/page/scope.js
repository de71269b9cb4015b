// One panel: axes, grid, cursor and zoom by uPlot; curves drawn over them from the streams' own columns, so that every
// row counts: where there are more rows than pixels, each pixel shows the least and the greatest of its rows.

const COLOURS = ["--c0", "--c1", "--c2", "--c3"];
const AXIS_PX = 62;

const colours = new Map();

// A colour of the theme by its name in style.css.
export function colour(name) {
  if (!colours.has(name)) {
    colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  }
  return colours.get(name);
}

export function forgetColours() {
  colours.clear();
}

export class Panel {
  constructor(told, shared) {
    this.told = told;
    this.shared = shared; // view, store, axis, cursors; see main.js
    this.range = [0, 1];
    this.traces = told.traces.map((trace, place) => ({ ...trace, place, isShown: true }));
    this.root = element("div", "panel");
    this.root.append(this.makeHead());
    this.plot = element("div", "plot");
    this.root.append(this.plot);
    this.chart = null;
  }

  makeHead() {
    const head = element("div", "head");
    const title = element("span");
    title.append(element("b", "", this.told.title), " ", element("span", "unit", this.told.unit));
    head.append(title);
    for (const trace of this.traces) {
      const key = element("button", "key");
      key.type = "button";
      key.title = "show or hide";
      const mark = element("i");
      mark.style.setProperty("--mark", `var(${COLOURS[trace.place % COLOURS.length]})`);
      trace.output = element("output", "", "–");
      key.append(mark, element("span", "", trace.label), trace.output);
      key.addEventListener("click", () => {
        trace.isShown = !trace.isShown;
        key.classList.toggle("hidden", !trace.isShown);
        this.shared.redraw();
      });
      head.append(key);
    }
    return head;
  }

  stream(trace) {
    return this.shared.store.find(trace.topic, this.shared.axis);
  }

  size(width, height) {
    if (this.chart) this.chart.setSize({ width, height });
    else this.make(width, height);
  }

  make(width, height) {
    const axis = (side) => ({
      side,
      stroke: () => colour("--soft"),
      grid: { stroke: () => colour("--grid"), width: 1 },
      ticks: { stroke: () => colour("--line"), width: 1, size: 4 },
      font: "11px system-ui, sans-serif",
      gap: 3,
    });
    const options = {
      width,
      height,
      padding: [6, 8, 0, 0],
      legend: { show: false },
      scales: { x: { time: false, range: () => this.shared.view }, y: { range: () => this.range } },
      axes: [
        { ...axis(2), size: 22 },
        { ...axis(3), size: AXIS_PX, space: 20, values: (_, ticks) => ticks.map(short) },
      ],
      series: [{}, { stroke: "transparent", points: { show: false } }],
      cursor: {
        sync: { key: "time", scales: ["x", null] },
        drag: { x: true, y: false, setScale: false },
        points: { show: false },
        y: false,
      },
      hooks: {
        draw: [(chart) => this.draw(chart)],
        setSelect: [(chart) => this.selected(chart)],
        setCursor: [(chart) => this.shared.hover(chart.cursor.left < 0 ? null : chart.posToVal(chart.cursor.left, "x"))],
      },
    };
    this.chart = new uPlot(options, [[0, 1], [null, null]], this.plot);
    this.chart.over.addEventListener("click", (event) => {
      const isDrag = this.wasSelecting;
      this.wasSelecting = false;
      if (!isDrag) this.shared.click(this.chart.posToVal(event.offsetX, "x"));
    });
    this.chart.over.addEventListener("dblclick", () => this.shared.zoomOut());
  }

  selected(chart) {
    if (chart.select.width < 4) return;
    this.wasSelecting = true;
    const from = chart.posToVal(chart.select.left, "x");
    const to = chart.posToVal(chart.select.left + chart.select.width, "x");
    chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.shared.zoom(from, to);
  }

  update(isLocked) {
    if (!this.chart) return;
    if (!isLocked) this.fit();
    const [from, to] = this.shared.view;
    this.chart.setData([[from, to], [null, null]], true);
  }

  // The range of what is in view, with some air; it grows at once and shrinks only where it has become far too wide.
  fit() {
    let low = Infinity;
    let high = -Infinity;
    const [from, to] = this.shared.view;
    for (const trace of this.traces) {
      const stream = trace.isShown && this.stream(trace);
      if (!stream) continue;
      const column = stream.column(trace.field);
      const end = stream.at(to);
      for (let row = stream.at(from); row < end; row += 1) {
        const value = column[row];
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    this.root.classList.toggle("empty", low > high);
    if (low > high) return;
    const scale = this.told.scale;
    const span = Math.max((high - low) * scale, 1e-9 + 1e-3 * Math.abs(high * scale));
    const wanted = [low * scale - 0.06 * span, high * scale + 0.06 * span];
    const [below, above] = this.range;
    const isInside = wanted[0] >= below && wanted[1] <= above;
    if (!isInside || above - below > 1.5 * (wanted[1] - wanted[0])) {
      this.range = [wanted[0] - 0.06 * span, wanted[1] + 0.06 * span];
    }
  }

  draw(chart) {
    const { ctx, bbox } = chart;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.lineWidth = 1.3 * devicePixelRatio;
    ctx.lineJoin = "round";
    for (const trace of [...this.traces].reverse()) { // what is named first is on top
      const stream = trace.isShown && this.stream(trace);
      if (!stream || !stream.rows) continue;
      ctx.strokeStyle = colour(COLOURS[trace.place % COLOURS.length]);
      ctx.beginPath();
      this.curve(ctx, bbox, stream, trace);
      ctx.stroke();
    }
    this.drawCursors(ctx, bbox, chart);
    ctx.restore();
  }

  curve(ctx, bbox, stream, trace) {
    const [from, to] = this.shared.view;
    const [low, high] = this.range;
    const time = stream.columns[0];
    const column = stream.column(trace.field);
    const begin = Math.max(stream.at(from) - 1, 0);
    const end = Math.min(stream.at(to) + 1, stream.rows);
    const perS = bbox.width / (to - from);
    const perUnit = (this.told.scale * bbox.height) / (high - low);
    const zero = bbox.top + bbox.height + (low * bbox.height) / (high - low);
    if (end - begin > 2 * bbox.width) crowded(ctx, time, column, begin, end, bbox.left, from, perS, zero, perUnit);
    else sparse(ctx, time, column, begin, end, bbox.left, from, perS, zero, perUnit, trace.holds);
  }

  drawCursors(ctx, bbox, chart) {
    const cursors = this.shared.cursors;
    if (!cursors) return;
    ctx.strokeStyle = colour("--ink");
    ctx.fillStyle = colour("--ink");
    ctx.lineWidth = devicePixelRatio;
    ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
    cursors.forEach((t, place) => {
      const x = Math.round(chart.valToPos(t, "x", true)) + 0.5;
      ctx.setLineDash(place ? [2 * devicePixelRatio, 3 * devicePixelRatio] : [6 * devicePixelRatio, 3 * devicePixelRatio]);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
      ctx.fillText("AB"[place], x + 3 * devicePixelRatio, bbox.top + 10 * devicePixelRatio);
    });
    ctx.setLineDash([]);
  }

  values(t) {
    for (const trace of this.traces) {
      const stream = this.stream(trace);
      const value = stream ? stream.value(trace.field, t) * this.told.scale : NaN;
      trace.output.textContent = number(value, this.span);
    }
  }

  get span() {
    return this.range[1] - this.range[0];
  }
}

function sparse(ctx, time, column, begin, end, left, from, perS, zero, perUnit, holds) {
  let isDown = false;
  let before = 0;
  for (let row = begin; row < end; row += 1) {
    const value = column[row];
    if (value !== value) {
      isDown = false;
      continue;
    }
    const x = left + (time[row] - from) * perS;
    const y = zero - value * perUnit;
    if (!isDown) ctx.moveTo(x, y);
    else {
      if (holds) ctx.lineTo(x, before);
      ctx.lineTo(x, y);
    }
    isDown = true;
    before = y;
  }
}

function crowded(ctx, time, column, begin, end, left, from, perS, zero, perUnit) {
  let isDown = false;
  let pixel = NaN;
  let least = 0;
  let most = 0;
  const flush = () => {
    if (pixel !== pixel) return;
    const x = left + pixel;
    if (isDown) ctx.lineTo(x, zero - least * perUnit);
    else ctx.moveTo(x, zero - least * perUnit);
    ctx.lineTo(x, zero - most * perUnit);
    isDown = true;
  };
  for (let row = begin; row < end; row += 1) {
    const value = column[row];
    if (value !== value) {
      flush();
      pixel = NaN;
      isDown = false;
      continue;
    }
    const here = Math.floor((time[row] - from) * perS);
    if (here !== pixel) {
      flush();
      pixel = here;
      least = value;
      most = value;
    } else if (value < least) least = value;
    else if (value > most) most = value;
  }
  flush();
}

export function element(tag, className = "", text = "") {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== "") made.textContent = text;
  return made;
}

// A value with as many digits as a range of values asks for: a thousandth of it.
export function number(value, span) {
  if (!Number.isFinite(value)) return "–";
  const digits = Math.min(9, Math.max(0, 3 - Math.ceil(Math.log10(span > 0 ? span : 1))));
  const text = value.toFixed(digits);
  return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−");
}

function short(tick) {
  return Math.abs(tick) >= 1e5 || (tick !== 0 && Math.abs(tick) < 1e-3) ? tick.toExponential(1) : `${+tick.toFixed(6)}`;
}

export { AXIS_PX, COLOURS };
