"""The Python library: functions and results that `import alula` offers."""
