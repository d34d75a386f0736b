"""Training of models, and everything around it; needs the `train` extra, which is imported only when it is used."""

from foreglow.lab.learning.weights import ImportedModel, import_weights

__all__ = ["ImportedModel", "import_weights"]
