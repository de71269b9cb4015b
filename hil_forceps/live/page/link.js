// The connection to the run: token, socket, and coming back after a break.

const WRONG_TOKEN = 4401;
const FIRST_WAIT_MS = 300;
const MAX_WAIT_MS = 3000;

// The token comes behind # once; a reload finds it in the session, and it stands in no history.
export function token() {
  const given = location.hash.slice(1);
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname);
  }
  return given || sessionStorage.getItem("token") || "";
}

export class Link {
  // take: { hello, status, frame, end, state } functions
  constructor(take) {
    this.take = take;
    this.token = token();
    this.waitMs = FIRST_WAIT_MS;
    this.hasEnded = false;
    this.bytes = 0;
    this.open();
  }

  open() {
    this.socket = new WebSocket(`ws://${location.host}/live`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => this.socket.send(this.token || "none");
    this.socket.onmessage = (event) => this.message(event.data);
    this.socket.onclose = (event) => this.closed(event);
  }

  message(data) {
    if (typeof data !== "string") {
      this.bytes += data.byteLength;
      this.take.frame(data);
      return;
    }
    const told = JSON.parse(data);
    if (told.kind === "hello") {
      this.waitMs = FIRST_WAIT_MS;
      this.take.state("ok", "connected");
      this.take.hello(told);
    } else if (told.kind === "status") {
      this.take.status(told);
    } else if (told.kind === "end") {
      this.hasEnded = true;
      this.take.end();
    }
  }

  closed(event) {
    if (this.hasEnded) {
      this.take.state("off", "the run has ended");
    } else if (event.code === WRONG_TOKEN) {
      this.take.state("bad", "This address has no valid token. Open the one that the run printed.");
    } else {
      this.take.state("warn", "The connection is lost; trying again. The run goes on by itself, or has ended.");
      setTimeout(() => this.open(), this.waitMs);
      this.waitMs = Math.min(2 * this.waitMs, MAX_WAIT_MS);
    }
  }

  ask(what) {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(what);
    return true;
  }
}
