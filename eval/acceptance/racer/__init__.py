"""Acceptance of RACER: does offline reinforcement learning pay here?"""
