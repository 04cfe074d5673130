"""Characters from files: their joints, and retargeting of motion onto them."""
