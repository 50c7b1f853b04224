"""Ways bytes and frames reach the machine: serial ports and CAN buses. No protocol of any instrument here."""
