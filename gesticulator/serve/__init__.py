"""The live server (audio in over a WebSocket, poses out), and the page of gesticulator view."""
