// What is in view as a table or a picture. The whole run is in its recording, bit by bit.

import { colour } from "./scope.js";

function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

// A row for each row of the first stream, in SI; of the others the value that was in force then.
export function table(store, axis, panels, [from, to]) {
  const wanted = new Map();
  for (const panel of panels) {
    for (const trace of panel.traces) {
      const stream = store.find(trace.topic, axis);
      if (stream && stream.rows) wanted.set(trace.field, { stream, column: stream.column(trace.field) });
    }
  }
  const base = store.streams.find((each) => each.axis === axis);
  const names = [...wanted.keys()];
  // The same field of two topics, as a measured and an estimated one have, has different names in its topics.
  const hasThinned = [...wanted.values()].some(({ stream }) => stream.hasThinned);
  const lines = [["time_s", ...names, ...(hasThinned ? ["thinned"] : [])].join(",")];
  const rows = new Map([...wanted.values()].map(({ stream }) => [stream, stream.at(from)]));
  const end = base.at(to);
  for (let row = base.at(from); row < end; row += 1) {
    const t = base.columns[0][row];
    for (const [stream, at] of rows) {
      let next = at;
      while (next < stream.rows && stream.columns[0][next] <= t) next += 1;
      rows.set(stream, next);
    }
    const cells = names.map((name) => {
      const { stream, column } = wanted.get(name);
      const value = column[rows.get(stream) - 1];
      return Number.isFinite(value) ? String(value) : "";
    });
    if (hasThinned) cells.push([...rows].some(([stream, at]) => stream.thinned[at - 1]) ? "1" : "0");
    lines.push([t.toFixed(9), ...cells].join(","));
  }
  return `${lines.join("\n")}\n`;
}

export function saveTable(text, name) {
  save(new Blob([text], { type: "text/csv" }), `${name}.csv`);
}

export function savePicture(panels, title, name) {
  const shown = panels.filter((panel) => panel.chart && panel.root.offsetParent);
  const scale = devicePixelRatio;
  const heading = 22 * scale;
  const width = Math.max(...shown.map((panel) => panel.chart.ctx.canvas.width));
  const height = shown.reduce((sum, panel) => sum + panel.chart.ctx.canvas.height + heading, heading);
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = height;
  const ctx = canvas.getContext("2d");
  ctx.fillStyle = colour("--paper");
  ctx.fillRect(0, 0, width, height);
  ctx.fillStyle = colour("--ink");
  ctx.font = `bold ${13 * scale}px system-ui, sans-serif`;
  ctx.fillText(title, 8 * scale, heading - 6 * scale);
  let top = heading;
  for (const panel of shown) {
    let left = 8 * scale;
    ctx.font = `${12 * scale}px system-ui, sans-serif`;
    ctx.fillStyle = colour("--ink");
    const text = `${panel.told.title} [${panel.told.unit}]`;
    ctx.fillText(text, left, top + heading - 6 * scale);
    left += ctx.measureText(text).width + 16 * scale;
    for (const trace of panel.traces.filter((each) => each.isShown)) {
      ctx.fillStyle = colour(`--c${trace.place % 4}`);
      ctx.fillText(trace.label, left, top + heading - 6 * scale);
      left += ctx.measureText(trace.label).width + 14 * scale;
    }
    ctx.drawImage(panel.chart.ctx.canvas, 0, top + heading);
    top += heading + panel.chart.ctx.canvas.height;
  }
  canvas.toBlob((blob) => save(blob, `${name}.png`));
}
