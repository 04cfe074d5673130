"""Sound: files, silence, onsets and beats, and the front ends that turn it into features."""
