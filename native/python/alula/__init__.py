"""alula: from a Gaussian splat to a safe flight."""

__version__ = "0.1.0"
