"""The hand-over from one publisher to another on live components, and the fence for one that hangs."""
