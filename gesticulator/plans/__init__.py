"""The gesture plan: what was decided, as a user reads and edits it, and what renders it again after edits."""
