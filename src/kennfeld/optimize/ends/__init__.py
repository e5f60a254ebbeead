"""Ends of a descent: kinks, ridges, runaways, slopes of zero."""
