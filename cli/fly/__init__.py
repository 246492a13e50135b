"""`alula fly`."""
