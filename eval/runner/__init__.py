"""What makes the figures: the context, bundles and policies that are played, rows that are trained and measured."""
