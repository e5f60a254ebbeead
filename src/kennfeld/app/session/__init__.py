"""A project that is open in the app: its state, the commands that change it, and what they change. No HTTP."""
