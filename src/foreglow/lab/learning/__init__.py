"""Training of models, and everything around it; needs the `train` extra, which is imported only when it is used."""

from foreglow.lab.learning.weights import import_weights

__all__ = ["import_weights"]
