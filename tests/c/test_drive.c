#include "drive_test.h"

void setUp(void) {}
void tearDown(void) {}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_readme_s_example);
    return UNITY_END();
}
