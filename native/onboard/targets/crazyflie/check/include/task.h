#ifndef CHECK_TASK_H
#define CHECK_TASK_H
void vTaskDelay(TickType_t ticks);
#endif
