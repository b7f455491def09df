"""A page that shows a run, or devices that answer, in a browser; `server.py` needs the extra `web`."""
