"""Training of the models, and the export of a frozen bundle."""
