"""How robots and hosts are reached: protocols, kinds of link, commands on hosts over SSH."""
