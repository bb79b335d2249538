"""Feet that go where they are planned: contact plans, body references, preview, swings and foothold choice."""
