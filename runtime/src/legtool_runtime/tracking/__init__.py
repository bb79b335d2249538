"""Feet that go where they are planned: contact plans, body references and a preview over whole-body control."""
