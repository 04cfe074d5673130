"""What the body does besides gestures: rest, idle motion, stance, head turns, frames on the clock."""
