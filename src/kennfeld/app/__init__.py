"""The web app: a session that holds a project, a server that serves one page, and the page itself."""
