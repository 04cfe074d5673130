"""The gesture plan: all decisions of a performance, in a file that can be read and edited."""
