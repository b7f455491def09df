"""Make definitions of protocol files of EPICS StreamDevice (`framekit import FILE.proto`)."""
