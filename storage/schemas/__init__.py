"""Message types of a recording: `.proto` files and the Python generated from them."""
