"""The tables, figures and claims of both papers, run again on any data set: `gesticulator ablate`."""
