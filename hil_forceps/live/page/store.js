// Rows of every stream as typed columns. Time is column 0, in seconds since the page's time began, and never falls.

const FIRST_ROWS = 1 << 13;
const MAX_ROWS = 1 << 19; // 8 minutes at 1 kHz; then the oldest quarter goes

export class Stream {
  constructor(told) {
    this.topic = told.topic;
    this.axis = told.axis;
    this.fields = told.fields;
    this.clear();
  }

  clear() {
    this.rows = 0;
    this.room = FIRST_ROWS;
    this.columns = this.fields.map(() => new Float64Array(FIRST_ROWS));
    this.thinned = new Uint8Array(FIRST_ROWS); // rows that are the edge of an envelope
    this.hasThinned = false;
  }

  column(field) {
    return this.columns[this.fields.indexOf(field)];
  }

  add(data, rows, isEnvelope) {
    this.makeRoom(rows);
    this.columns.forEach((column, place) => column.set(data.subarray(place * rows, (place + 1) * rows), this.rows));
    this.thinned.fill(isEnvelope ? 1 : 0, this.rows, this.rows + rows);
    this.hasThinned = this.hasThinned || isEnvelope;
    const time = this.columns[0];
    for (let row = Math.max(this.rows, 1); row < this.rows + rows; row += 1) {
      if (time[row] < time[row - 1]) time[row] = time[row - 1];
    }
    this.rows += rows;
  }

  makeRoom(rows) {
    while (this.rows + rows > this.room) {
      if (this.room < MAX_ROWS) {
        this.room *= 2;
        this.columns = this.columns.map((column) => grown(column, new Float64Array(this.room)));
        this.thinned = grown(this.thinned, new Uint8Array(this.room));
      } else {
        const gone = Math.max(this.room >> 2, rows);
        for (const column of [...this.columns, this.thinned]) column.copyWithin(0, gone, this.rows);
        this.rows -= gone;
      }
    }
  }

  get newest() {
    return this.rows ? this.columns[0][this.rows - 1] : -Infinity;
  }

  // The first row whose time is not below t.
  at(t) {
    const time = this.columns[0];
    let low = 0;
    let high = this.rows;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (time[middle] < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  // The value in force at t: of the last row at or before it that has one, for a tick without a new sample has none.
  value(field, t) {
    const column = this.column(field);
    let row = this.at(t + 1e-9) - 1;
    const oldest = Math.max(row - 20, 0);
    while (row > oldest && column[row] !== column[row]) row -= 1;
    return row < 0 ? NaN : column[row];
  }
}

function grown(from, to) {
  to.set(from);
  return to;
}

export class Store {
  constructor(told) {
    this.streams = told.map((each) => new Stream(each));
  }

  find(topic, axis) {
    return this.streams.find((each) => each.topic === topic && each.axis === axis);
  }

  clear() {
    for (const stream of this.streams) stream.clear();
  }

  // A binary message of the server: kind, length of a JSON head, the head, then columns of doubles.
  take(buffer) {
    const view = new DataView(buffer);
    const length = view.getUint32(4, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
    let at = 8 + length;
    for (const part of head.parts) {
      const stream = this.streams[part.stream];
      const count = part.rows * stream.fields.length;
      stream.add(new Float64Array(buffer, at, count), part.rows, part.stands_for > 0);
      at += 8 * count;
    }
    return head;
  }

  get newest() {
    return Math.max(...this.streams.map((stream) => stream.newest));
  }
}
