"""What engines of every system use: devices, stored programs, run ids, and the versions of MuJoCo."""
