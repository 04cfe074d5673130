// Runs beside the sound hardware: hands on what the microphone hears, 20 ms at a time.
class Capture extends AudioWorkletProcessor {
  constructor() {
    super();
    this.piece = new Float32Array(Math.round(sampleRate / 50));
    this.filled = 0;
  }

  process([[channel]]) {
    for (let at = 0; channel && at < channel.length;) {
      const count = Math.min(channel.length - at, this.piece.length - this.filled);
      this.piece.set(channel.subarray(at, at + count), this.filled);
      at += count;
      this.filled += count;
      if (this.filled === this.piece.length) {
        this.port.postMessage({ piece: this.piece.slice(), end: currentTime + at / sampleRate });
        this.filled = 0;
      }
    }
    return true;
  }
}
registerProcessor("capture", Capture);
