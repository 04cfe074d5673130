"""The gesture plan: every decision behind a performance, as a file to read and edit."""
