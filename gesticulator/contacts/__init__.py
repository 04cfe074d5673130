"""Hands kept out of bodies: the default character's trunk, face and thighs, and the trunks of others.

A hand of the default character is only ever moved ahead (`default_body`, `lap`). For a hand of another character, the
default one shows on which side of the body it belongs, and it may be moved sideways (`other_bodies`).
"""
