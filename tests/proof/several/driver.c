#define SEVERAL 1
#include "../compensator/driver.c"
