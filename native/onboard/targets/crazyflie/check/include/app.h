#ifndef CHECK_APP_H
#define CHECK_APP_H
void appMain(void);
#endif
