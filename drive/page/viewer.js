// rerun's viewer, fed over a WebSocket. Unlike the viewer's own page, this one loads nothing from other servers.

import { address } from "./link.js";

const CHANNEL = "robots";
const AGAIN_MS = 1000;

/** The viewer keeps the recording of every scene: beyond this size the page reloads. */
const MOST_BYTES = 1 << 30;

const wait = document.getElementById("wait");

// Forward keys to the outer page: otherwise the driving keys would move the viewer's camera.
const tell = (kind, detail = {}) => parent.postMessage({ kind, detail }, "*");
for (const kind of ["keydown", "keyup"]) {
  const forward = (event) => {
    event.stopImmediatePropagation();
    if (event.code === "Space" || event.code.startsWith("Arrow")) event.preventDefault();
    const { code, key, shiftKey, ctrlKey, altKey, metaKey, repeat } = event;
    tell(kind, { code, key, shiftKey, ctrlKey, altKey, metaKey, repeat });
  };
  addEventListener(kind, forward, { capture: true });
}
addEventListener("blur", () => tell("blur"));

// Block the viewer's usage reports; the content security policy would refuse them, too.
const { fetch } = window;
window.fetch = (what, ...more) => {
  const { origin } = new URL(what.url ?? what, location.href);
  return origin === location.origin ? fetch(what, ...more) : Promise.resolve(new Response(null, { status: 204 }));
};

// The viewer reads new data for ten milliseconds of each frame and defers the rest: on a slow machine a robot is then drawn half
// old, half new, and data pile up. A clock that advances once per frame lets it read everything.
const { requestAnimationFrame } = window;
const clock = performance.now.bind(performance);
let ticked = clock();
performance.now = () => ticked;
window.requestAnimationFrame = (draw) =>
  requestAnimationFrame((time) => {
    ticked = clock();
    draw(time);
  });

const hidden = "Hidden";
const options = {
  url: [],
  hide_welcome_screen: true,
  enable_history: false,
  notebook: false,
  render_backend: new URLSearchParams(location.search).get("renderer") ?? undefined,
  panel_state_overrides: { top: hidden, blueprint: hidden, selection: hidden, time: hidden },
};

try {
  const { memory } = await wasm_bindgen({ module_or_path: "rerun/re_viewer_bg.wasm" });
  window.memory = memory;
  const viewer = new wasm_bindgen.WebHandle(options);
  await viewer.start(document.getElementById("canvas"));
  wait.remove();
  feed(viewer, memory);
  tell("ready");
} catch (error) {
  wait.textContent = `The viewer cannot run in this browser: ${error}. The robots can still be driven; drive --connect shows them in rerun itself.`;
}

function feed(viewer, memory) {
  let channels = 0;
  const open = () => {
    const channel = `${CHANNEL} ${(channels += 1)}`;
    const socket = new WebSocket(address("/view"));
    socket.binaryType = "arraybuffer";
    socket.onopen = () => viewer.open_channel(channel, CHANNEL);
    socket.onmessage = ({ data }) => {
      if (memory.buffer.byteLength > MOST_BYTES) location.reload();
      viewer.send_rrd_to_channel(channel, new Uint8Array(data));
      // Ask for more only when this has been shown: a slow viewer misses frames instead of queueing them.
      requestAnimationFrame(() => socket.readyState === WebSocket.OPEN && socket.send("shown"));
    };
    socket.onclose = () => {
      viewer.close_channel(channel);
      setTimeout(open, AGAIN_MS);
    };
  };
  open();
}
