"""Learned models of black-box walking controllers: collect, train, evaluate, export."""

__version__ = "0.1.0"
