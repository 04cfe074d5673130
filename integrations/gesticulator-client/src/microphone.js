// Sound of a microphone or of any track, such as a voice that comes by WebRTC, to a stream.

/** Feed a MediaStreamTrack to a stream; the context's rate must be the stream's. capture: address of capture.js. Returns a function that ends it. */
export async function feedTrack(stream, track, context, capture) {
  if (context.sampleRate !== stream.sampleRate) throw new Error(`the stream takes ${stream.sampleRate} Hz, and the context has ${context.sampleRate}`);
  await context.audioWorklet.addModule(capture);
  const source = context.createMediaStreamSource(new MediaStream([track]));
  const node = new AudioWorkletNode(context, "gesticulator-capture", { numberOfOutputs: 0 });
  node.port.onmessage = ({ data }) => stream.send(data);
  source.connect(node);
  return () => {
    node.port.onmessage = null;
    source.disconnect();
  };
}

/** Feed the microphone; asks for it. Returns a function that ends it and lets go of the microphone. */
export async function feedMicrophone(stream, context, capture) {
  const media = await navigator.mediaDevices.getUserMedia({ audio: { channelCount: 1 } });
  const end = await feedTrack(stream, media.getAudioTracks()[0], context, capture);
  return () => {
    end();
    for (const track of media.getTracks()) track.stop();
  };
}
