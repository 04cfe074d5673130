"""The live server: audio in and poses out, over a WebSocket or by VMC."""
