// rerun's viewer, fed over a WebSocket. Its own page would fetch fonts from elsewhere; this one fetches nothing.

import { address } from "./link.js";

const CHANNEL = "robots";
const AGAIN_MS = 1000;
const wait = document.getElementById("wait");

// Keys that drive are for the page around; the viewer would fly its camera with them.
for (const kind of ["keydown", "keyup"]) {
  addEventListener(
    kind,
    (event) => {
      event.stopImmediatePropagation();
      const { code, key, shiftKey, ctrlKey, altKey, metaKey, repeat } = event;
      const forwarded = new parent.KeyboardEvent(kind, { code, key, shiftKey, ctrlKey, altKey, metaKey, repeat, bubbles: true, cancelable: true });
      if (parent !== window && !parent.document.body.dispatchEvent(forwarded)) event.preventDefault();
    },
    { capture: true },
  );
}
addEventListener("blur", () => parent !== window && parent.dispatchEvent(new parent.Event("blur")));

const hidden = "hidden";
const options = {
  url: [],
  hide_welcome_screen: true,
  enable_history: false,
  notebook: false,
  theme: "dark",
  render_backend: new URLSearchParams(location.search).get("renderer") ?? undefined,
  panel_state_overrides: { top: hidden, blueprint: hidden, selection: hidden, time: hidden },
};

try {
  await wasm_bindgen({ module_or_path: "rerun/re_viewer_bg.wasm" });
  const viewer = new wasm_bindgen.WebHandle(options);
  await viewer.start(document.getElementById("canvas"));
  wait.remove();
  feed(viewer);
} catch (error) {
  wait.textContent = `The viewer cannot run in this browser: ${error}. The robots can still be driven; drive --connect shows them in rerun itself.`;
}

function feed(viewer) {
  let channels = 0;
  const open = () => {
    const channel = `${CHANNEL} ${(channels += 1)}`;
    const socket = new WebSocket(address("/view"));
    socket.binaryType = "arraybuffer";
    socket.onopen = () => viewer.open_channel(channel, CHANNEL);
    socket.onmessage = ({ data }) => viewer.send_rrd_to_channel(channel, new Uint8Array(data));
    socket.onclose = () => {
      viewer.close_channel(channel);
      setTimeout(open, AGAIN_MS);
    };
  };
  open();
}
