"""Plans that are edited: rendered again from the change on, and moved onto another export of their sound."""
