"""What a measurement is and how one is run: geometry, campaign, plan, scheduler, calibration, store."""
