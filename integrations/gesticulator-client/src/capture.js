// Runs beside the sound hardware, as an AudioWorklet: hands on what it hears, 20 ms at a time.
class GesticulatorCapture extends AudioWorkletProcessor {
  constructor() {
    super();
    this.piece = new Float32Array(Math.round(sampleRate / 50));
    this.filled = 0;
  }

  process([channels]) {
    const [first] = channels;
    for (let k = 0; first && k < first.length; k++) {
      let sum = 0;
      for (const channel of channels) sum += channel[k];
      this.piece[this.filled++] = sum / channels.length;
      if (this.filled === this.piece.length) {
        this.port.postMessage(this.piece.slice());
        this.filled = 0;
      }
    }
    return true;
  }
}
registerProcessor("gesticulator-capture", GesticulatorCapture);
