// The connection to the robots: one WebSocket that reconnects by itself.

const AGAIN_MS = 1000;

/** Returns the address of a socket of this server, with the token from the page's address. */
export function address(path) {
  const token = new URLSearchParams(location.search).get("token") ?? "";
  return `ws://${location.host}${path}?token=${encodeURIComponent(token)}`;
}

/** Hands every message to `on.hello`, `on.state` or `on.refused`, and calls `on.lost` when the connection closes. */
export function connect(on) {
  let socket;
  const open = () => {
    socket = new WebSocket(address("/control"));
    socket.onmessage = ({ data }) => {
      for (const [kind, content] of Object.entries(JSON.parse(data))) on[kind]?.(content);
    };
    socket.onclose = () => {
      on.lost();
      setTimeout(open, AGAIN_MS);
    };
  };
  open();
  return (request) => {
    if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(request));
  };
}
