"""The gesture plan: what was decided for a recording, as a file that people read and edit."""
