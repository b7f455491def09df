"""Services: requests by address, and their replies, as a client asks and a server answers."""
