// States over time as coloured bands, aligned with the plots: of the rows of a pixel the gravest counts.

import { AXIS_PX, colour, element } from "./scope.js";

const GRAVITY = { off: 0, ok: 1, note: 2, warn: 3, bad: 4 };
const ROW_PX = 20;

export class Lanes {
  constructor(told, shared) {
    this.told = told;
    this.shared = shared;
    this.root = element("div", "panel lanes");
    const head = element("div", "head");
    for (const lane of told) {
      const key = element("span", "key");
      lane.output = element("output", "", "–");
      key.append(element("b", "", lane.title), lane.output);
      head.append(key);
    }
    this.canvas = element("canvas");
    this.root.append(head, this.canvas);
    this.canvas.addEventListener("mousemove", (event) => this.shared.hover(this.time(event)));
    this.canvas.addEventListener("mouseleave", () => this.shared.hover(null));
    this.canvas.addEventListener("click", (event) => this.shared.click(this.time(event)));
  }

  time(event) {
    const [from, to] = this.shared.view;
    const width = this.canvas.clientWidth - AXIS_PX - 8;
    return from + ((event.offsetX - AXIS_PX) / width) * (to - from);
  }

  code(lane, value) {
    return lane.codes[String(value)] || { name: Number.isFinite(value) ? `code ${value}` : "–", level: "off" };
  }

  at(lane, t) {
    const stream = this.shared.store.find(lane.topic, this.shared.axis);
    return this.code(lane, stream ? stream.value(lane.field, t) : NaN);
  }

  size(width) {
    const height = ROW_PX * this.told.length;
    this.canvas.width = Math.round(width * devicePixelRatio);
    this.canvas.height = Math.round(height * devicePixelRatio);
    this.canvas.style.height = `${height}px`;
  }

  update() {
    const ctx = this.canvas.getContext("2d");
    const scale = devicePixelRatio;
    const left = AXIS_PX * scale;
    const width = this.canvas.width - left - 8 * scale;
    ctx.clearRect(0, 0, this.canvas.width, this.canvas.height);
    ctx.font = `${11 * scale}px system-ui, sans-serif`;
    ctx.textBaseline = "middle";
    this.told.forEach((lane, place) => {
      const top = (place * ROW_PX + 2) * scale;
      const height = (ROW_PX - 4) * scale;
      ctx.fillStyle = colour("--soft");
      ctx.textAlign = "right";
      ctx.fillText(lane.title, left - 6 * scale, top + height / 2);
      ctx.fillStyle = colour("--grid");
      ctx.fillRect(left, top, width, height);
      this.bands(ctx, lane, left, top, width, height);
    });
    this.drawCursors(ctx, left, width);
  }

  bands(ctx, lane, left, top, width, height) {
    const stream = this.shared.store.find(lane.topic, this.shared.axis);
    if (!stream || !stream.rows) return;
    const [from, to] = this.shared.view;
    const time = stream.columns[0];
    const column = stream.column(lane.field);
    const begin = Math.max(stream.at(from) - 1, 0);
    const end = stream.at(to);
    let x = Math.max(0, ((time[begin] - from) / (to - from)) * width);
    let code = this.code(lane, column[begin]);
    let startX = x;
    const paint = (endX) => {
      if (endX <= startX) return;
      ctx.fillStyle = colour(`--${code.level}`);
      ctx.globalAlpha = code.level === "ok" ? 0.55 : code.level === "off" ? 0.3 : 0.9;
      ctx.fillRect(left + startX, top, endX - startX, height);
      ctx.globalAlpha = 1;
    };
    for (let row = begin + 1; row < end; row += 1) {
      if (column[row] === column[row - 1]) continue;
      const next = this.code(lane, column[row]);
      x = Math.floor(((time[row] - from) / (to - from)) * width);
      if (x - startX < 1 && GRAVITY[next.level] <= GRAVITY[code.level]) continue;
      paint(x);
      startX = x;
      code = next;
    }
    paint(Math.min(width, ((Math.min(stream.newest, to) - from) / (to - from)) * width));
  }

  drawCursors(ctx, left, width) {
    const [from, to] = this.shared.view;
    ctx.strokeStyle = colour("--ink");
    ctx.lineWidth = devicePixelRatio;
    for (const t of this.shared.cursors || []) {
      if (t < from || t > to) continue;
      const x = left + ((t - from) / (to - from)) * width;
      ctx.beginPath();
      ctx.moveTo(x, 0);
      ctx.lineTo(x, this.canvas.height);
      ctx.stroke();
    }
  }

  values(t) {
    for (const lane of this.told) lane.output.textContent = this.at(lane, t).name;
  }
}
