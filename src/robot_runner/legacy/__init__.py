"""Load config files of the earlier tools as configs of Robot Runner."""
