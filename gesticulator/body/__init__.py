"""What a body does besides gesturing: rest, life, stance, head turns, frames on the clock."""
