"""What is chosen before the search: smoothness and shifts."""
