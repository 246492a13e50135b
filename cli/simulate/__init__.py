"""`alula simulate`."""
