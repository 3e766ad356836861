"""The live view: the running system as one document, kept up to date from what components push to the manager."""

PUBLIC = "LiveView SystemView VERSION view_forms viewing"
