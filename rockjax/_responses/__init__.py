"""One scene: its peak response, its history, and both as datasets."""
