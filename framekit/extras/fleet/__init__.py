"""Report runs to a broker, list the gateways that report to it, and roll run files out to them."""
