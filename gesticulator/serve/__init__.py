"""The live server (audio in and poses out over a WebSocket), and the page of gesticulator view."""
