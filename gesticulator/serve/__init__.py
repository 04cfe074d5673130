"""The server of live gestures: sound comes in over a WebSocket, poses go out."""
