// The page's stream: the client that other pages use, on the server that the page came from.

import { GestureStream } from "../../../integrations/gesticulator-client/src/stream.js";

export class Stream extends GestureStream {
  constructor(rate, options, onEvent) {
    const token = new URLSearchParams(location.hash.slice(1)).get("token");
    super(location.origin.replace("http", "ws") + "/stream", { sampleRate: rate, options, token: token ?? undefined, onEvent });
    this.begun = performance.now();
  }
}
