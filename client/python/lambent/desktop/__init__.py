"""The desktop viewer. All but `window` and `opengl` works without a window and without VTK."""
