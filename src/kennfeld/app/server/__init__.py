"""The server of the app: one page, one socket, and the checks that keep others out."""
