"""The optical bench behind the simulated instruments, and measurements on it with and without the wire."""
