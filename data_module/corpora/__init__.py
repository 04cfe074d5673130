"""Corpora: a reader each (`data_module.corpora.base` describes them) and the table of readers (`.table`)."""
