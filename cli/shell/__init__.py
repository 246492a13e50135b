"""What all commands share: options, help, progress, provenance of outputs."""
